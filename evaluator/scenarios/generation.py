"""Drawing the frozen scenario lists: objects from a keyed generator, tools in hand from reference picks or a policy.

A list is made once and then only read: evaluations depend on its bytes, not on numpy's random streams. An object that
the picker fails to turn into a tool is drawn again; the manifest says how often that happened.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, NamedTuple

from evaluator.protocol import SCENARIOS
from evaluator.scenarios import (
    SPLITS,
    encode_list,
    load_list,
    manifest_path,
    update_manifest,
    write_list,
)
from evaluator.scenarios.policy_picks import Picker, draw_picked
from evaluator.scenarios.suites import SUITE
from evaluator.sim.parameters import parameters_hash
from evaluator.sim.reference import prepare
from evaluator.sim.simulator import Simulator, process_simulator
from evaluator.sim.spawn import episode_generator
from rema_data.errors import InputError, IntegrityError
from rema_data.interrupts import check
from rema_data.manifests import read_manifest
from rema_data.progress import Progress, Silent
from rema_data.repair import restore
from rema_data.schema import TASKS, Scenario, check_task, tool_steps

__all__ = [
    "ROOT_SEED",
    "Drawn",
    "check_kind",
    "draw_scenario",
    "enter_list",
    "generate_list",
    "named_list",
    "picked_list",
    "write_lists",
    "write_named",
]

ROOT_SEED = 2112_00359
"""Root of every frozen list; ``test`` and ``val`` are separate domains of it, and collection has a third."""
_CHUNK = 50
_PICKED_CHUNK = 500
"""Scenarios whose picks are asked about together; with the batches of the questions it belongs to a list's identity."""


class Drawn(NamedTuple):
    """A scenario and the number of objects that were drawn again for it."""

    scenario: Scenario
    redrawn: int


def draw_scenario(simulator: Simulator, task: str, split: str, index: int, root: int = ROOT_SEED) -> Drawn:
    """One scenario: a function of (root, task, split, index) and of the simulator."""
    ready = prepare(simulator, task, episode_generator(root, split, task, index))
    return Drawn(ready.scenario(task, split, index), ready.redrawn)


def _draw_chunk(job: tuple[str, str, range, int]) -> list[Drawn]:
    task, split, indices, root = job
    return [draw_scenario(process_simulator(), task, split, index, root) for index in indices]


def generate_list(task: str, split: str, count: int, pool: Executor, root: int = ROOT_SEED) -> Iterator[Drawn]:
    """Scenarios 0 to ``count`` - 1 of a list, in order, for any number of workers."""
    starts = range(0, count, _CHUNK)
    jobs = [(check_task(task), split, range(start, min(start + _CHUNK, count)), root) for start in starts]
    for chunk in pool.map(_draw_chunk, jobs):
        check()
        yield from chunk


def picked_list(
    task: str, split: str, count: int, pool: Executor, picker: Picker, root: int = ROOT_SEED
) -> Iterator[Drawn]:
    """The same with the tools as a policy picked them; PolicyFailureError where it cannot."""
    check_task(task)
    for start in range(0, count, _PICKED_CHUNK):
        indices = range(start, min(start + _PICKED_CHUNK, count))
        generators = {index: episode_generator(root, split, task, index) for index in indices}
        for one in draw_picked(task, generators, picker, pool):
            yield Drawn(one.scenario(task, split), one.redrawn)


def write_lists(
    version: str,
    pool: Executor,
    tasks: tuple[str, ...] = tuple(TASKS),
    counts: dict[str, int] | None = None,
    *,
    progress: Progress | None = None,
    picker: Picker | None = None,
    keep: tuple[str, ...] = (),
) -> Path:
    """Write a new version of the scenario lists and its manifest; a list that the manifest names is never changed.

    ``version`` is a folder under ``manifests/scenarios``; ``counts`` has the scenarios of each split, by default
    ``evaluator.protocol.SCENARIOS``; ``picker`` picks the tools, by default the privileged reference policy. The new
    manifest names the present lists of the tasks in ``keep`` and, with a picker, of those without tools; they are not
    written again. A file that no manifest names was left by a killed process: its list is drawn again.

    Returns the manifest's path. Raises InputError for an unknown task, a count below 1 or a suite, IntegrityError where
    the manifest cannot be read, or a list that it names is gone and drawing it again gives another, and StorageError
    where the disk is full or may not be written.
    """
    manifest, sink = manifest_path(version), progress or Silent()
    check_kind(manifest, version, suite=False)
    origin = {} if picker is None else {"picker": picker.name, "picker_digest": picker.digest}
    for split in SPLITS:
        count = (counts or SCENARIOS)[split]
        if count < 1:
            raise InputError(f"a {split} list of {count} scenarios", hint="give each split at least one", count=count)
        for task in (*keep, *tasks):
            entry = named_list(manifest, task, split)
            if entry is not None and (manifest.parent / entry["file"]).exists():
                continue
            if task in keep or (picker is not None and not tool_steps(task)):
                _name_again(manifest, version, task, split)
                continue
            sink.phase(f"{task}/{split}", count)
            picked = None if picker is None else picked_list(task, split, count, pool, picker)
            drawn: list[Drawn] = []
            for item in picked or generate_list(task, split, count, pool):
                drawn.append(item)
                sink.advance(1)
            write_named(manifest, version, drawn, entry, f"{ROOT_SEED}/{split}", **origin)
    return manifest


def _entries(manifest: Path) -> dict[str, dict[str, Any]]:
    """The lists in a manifest, by name; empty where there is no manifest."""
    if not manifest.is_file():
        return {}
    return read_manifest(manifest, "scenario manifest", lambda content: dict(content["lists"]))


def check_kind(manifest: Path, version: str, *, suite: bool) -> None:
    """Raise InputError where the lists of a manifest are a suite and should be clean, or the other way round."""
    if not manifest.is_file():
        return
    if suite != read_manifest(manifest, "scenario manifest", lambda content: SUITE in content):
        found, fix = ("clean lists", "drop --suite") if suite else ("a suite", "add --suite")
        raise InputError(f"{version} holds {found}", hint=f"{fix}, or choose another name", path=str(manifest))


def named_list(manifest: Path, task: str, split: str) -> dict[str, Any] | None:
    """What a manifest says of a list; None where it does not name it, or does not exist."""
    return _entries(manifest).get(f"{check_task(task)}/{split}")


def write_named(
    manifest: Path, version: str, drawn: Sequence[Drawn], named: dict[str, Any] | None, seed_domain: str, **origin: Any
) -> None:
    """Write a list and name it in the manifest, whose entry for it was ``named`` so far.

    Raises IntegrityError where the manifest names another list.
    """
    scenarios = [item.scenario for item in drawn]
    task, split = scenarios[0].task, scenarios[0].split
    file = manifest.parent / f"{task}_{split}.parquet"
    if named is not None and hashlib.sha256(encode_list(scenarios)).hexdigest() != named["sha256"]:
        raise IntegrityError(
            f"{manifest} names {named['file']}, which is gone, and {task}/{split} drawn again is another list",
            hint=f"{restore(file)}; or choose another VERSION",
            path=str(file),
        )
    enter_list(manifest, version, drawn, seed_domain, **origin)


def enter_list(manifest: Path, version: str, drawn: Sequence[Drawn], seed_domain: str, **origin: Any) -> None:
    """Write the list of what was drawn beside a manifest, and name it there: see ``update_manifest``."""
    scenarios = [item.scenario for item in drawn]
    task, split = scenarios[0].task, scenarios[0].split
    file = manifest.parent / f"{task}_{split}.parquet"
    update_manifest(
        manifest,
        version,
        f"{task}/{split}",
        file=file.name,
        sha256=write_list(file, scenarios),
        count=len(scenarios),
        seed_domain=seed_domain,
        redrawn=sum(item.redrawn for item in drawn),
        parameters=parameters_hash(),
        **origin,
    )


def _name_again(manifest: Path, version: str, task: str, split: str) -> None:
    """Enter the present list of a task without tools in the manifest of another version."""
    name, present = f"{task}/{split}", manifest_path(load_list(task, split).version)
    entry = _entries(present)[name]
    file = (present.parent / entry["file"]).resolve()  # maybe in the folder of an older version
    update_manifest(
        manifest, version, name, **entry | {"file": Path(os.path.relpath(file, manifest.parent.resolve())).as_posix()}
    )
