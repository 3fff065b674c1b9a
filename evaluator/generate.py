"""Drawing the frozen scenario lists: objects from a keyed generator, tools in hand from reference picks or a policy.

A list is made once and then only read: evaluations depend on its bytes, not on numpy's random streams. An object that
the picker fails to turn into a tool is drawn again; the manifest says how often that happened.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from evaluator.engines import make_engine
from evaluator.engines.worker import die_with
from evaluator.picked import draw_picked
from evaluator.policy import PolicySpec, digest
from evaluator.runner.backend import Backend, default_backend
from evaluator.scenarios import SPLITS, load_list, manifest_path, reference_tools, update_manifest, write_list
from evaluator.sim.parameters import WORLD, parameters_hash
from evaluator.sim.reference import prepare
from evaluator.sim.simulator import Simulator
from evaluator.sim.spawn import episode_generator
from rema_data.errors import InputError
from rema_data.schema import TASKS, Scenario, check_task

__all__ = ["COUNTS", "ROOT_SEED", "Picker", "draw_scenario", "generate_list", "picked_list", "write_lists"]

ROOT_SEED = 2112_00359
"""Root of every frozen list; ``test`` and ``val`` are separate domains of it, and collection has a third."""
COUNTS = {"test": 10_000, "val": 2_000}
_CHUNK = 50
_PICKED_CHUNK = 500
"""Scenarios whose picks are asked about together; with the batches of the questions it belongs to a list's identity."""


@dataclass(frozen=True, slots=True)
class Picker:
    """A policy that picks the tools of a list.

    Attributes
    ----------
    spec : PolicySpec
    checkpoint : Path or None
    log : Path
        Where what it prints is kept.
    device : str
    """

    spec: PolicySpec
    checkpoint: Path | None
    log: Path
    device: str = "cpu"


@dataclass(frozen=True, slots=True)
class Drawn:
    """A scenario and the number of objects that were drawn again for it."""

    scenario: Scenario
    redrawn: int


def draw_scenario(simulator: Simulator, task: str, split: str, index: int) -> Drawn:
    """One scenario: a function of (task, split, index) and of the simulator.

    Parameters
    ----------
    simulator : Simulator
    task, split : str
    index : int
    """
    ready = prepare(simulator, task, episode_generator(ROOT_SEED, split, task, index))
    return Drawn(Scenario(task, split, index, ready.placements, ready.grips, ready.pinch), ready.redrawn)


_simulator: Simulator | None = None


def _draw_chunk(job: tuple[str, str, range]) -> list[Drawn]:
    global _simulator
    if _simulator is None:
        _simulator = Simulator(WORLD)
    task, split, indices = job
    return [draw_scenario(_simulator, task, split, index) for index in indices]


def generate_list(task: str, split: str, count: int, workers: int = 2) -> Iterator[Drawn]:
    """Scenarios 0 to ``count`` - 1 of a list, in order, whatever the number of workers."""
    check_task(task)
    jobs = [(task, split, range(start, min(start + _CHUNK, count))) for start in range(0, count, _CHUNK)]
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=spawn, initializer=die_with, initargs=(os.getpid(),)) as pool:
        for chunk in pool.map(_draw_chunk, jobs):
            yield from chunk


def picked_list(
    task: str, split: str, count: int, picker: Picker, workers: int = 2, backend: Backend | None = None
) -> Iterator[Drawn]:
    """The same with the tools as a policy picked them.

    Raises
    ------
    SubmissionError, PolicyFailureError
        The policy cannot be loaded, or cannot pick.
    InfrastructureError
        A worker died twice on the same pick.
    """
    check_task(task)
    world = backend or default_backend()
    engine = make_engine("process", workers, world.simulator)
    spawn = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=spawn, initializer=die_with, initargs=(os.getpid(),))
    with (
        pool,
        closing(engine),
        world.open_policy(picker.spec, picker.checkpoint, picker.device, picker.log, None) as policy,
    ):
        for start in range(0, count, _PICKED_CHUNK):
            indices = range(start, min(start + _PICKED_CHUNK, count))
            generators = {index: episode_generator(ROOT_SEED, split, task, index) for index in indices}
            for one in draw_picked(task, generators, policy, engine, pool, world):
                yield Drawn(one.scenario(task, split), one.redrawn)


def write_lists(
    version: str,
    tasks: tuple[str, ...] = tuple(TASKS),
    counts: dict[str, int] | None = None,
    workers: int = 2,
    advance: Callable[[str, int], None] = lambda name, count: None,
    picker: Picker | None = None,
) -> Path:
    """Write a new version of the scenario lists and its manifest; a list that is there is kept, never changed.

    With a picker, tasks without tools keep the lists of the present version: they are named, not written again.

    Parameters
    ----------
    version : str
        Name of the folder under ``manifests/scenarios``.
    tasks : tuple of str
    counts : dict, optional
        Scenarios of each split; ``COUNTS`` by default.
    workers : int
    advance : callable
        Told (list name, scenarios done so far).
    picker : Picker, optional
        Picks the tools; the privileged reference picks by default.

    Returns
    -------
    Path
        The manifest.

    Raises
    ------
    InputError
        Unknown task, or a count below 1.
    StorageError
        The disk is full or may not be written.
    """
    manifest = manifest_path(version)
    for split in SPLITS:
        count = (counts or COUNTS)[split]
        if count < 1:
            raise InputError(f"a {split} list of {count} scenarios", hint="give each split at least one", count=count)
        for task in tasks:
            file = f"{check_task(task)}_{split}.parquet"
            if (manifest.parent / file).exists():
                continue
            if picker is not None and not reference_tools(task):
                _name_again(manifest, version, task, split)
                continue
            origin = (
                {}
                if picker is None
                else {"picker": picker.spec.name, "picker_digest": digest(picker.spec, picker.checkpoint)}
            )
            drawn: list[Drawn] = []
            source = (
                generate_list(task, split, count, workers)
                if picker is None
                else picked_list(task, split, count, picker, workers)
            )
            for item in source:
                drawn.append(item)
                advance(f"{task}/{split}", len(drawn))
            sha256 = write_list(manifest.parent / file, [item.scenario for item in drawn])
            update_manifest(
                manifest,
                version,
                f"{task}/{split}",
                file=file,
                sha256=sha256,
                count=count,
                seed_domain=f"{ROOT_SEED}/{split}",
                redrawn=sum(item.redrawn for item in drawn),
                parameters=parameters_hash(),
                **origin,
            )
    return manifest


def _name_again(manifest: Path, version: str, task: str, split: str) -> None:
    """Enter the present list of a task without tools in the manifest of another version."""
    frozen = load_list(task, split)
    update_manifest(
        manifest,
        version,
        f"{task}/{split}",
        file=f"../{frozen.version}/{task}_{split}.parquet",
        sha256=frozen.sha256,
        count=len(frozen.scenarios),
        seed_domain=f"{ROOT_SEED}/{split}",
        redrawn=0,
        parameters=parameters_hash(),
    )
