"""Drawing the frozen scenario lists: objects from a keyed generator, tools-in-hand from the reference picks.

A list is made once and then only read: evaluations depend on its bytes, not on numpy's random streams. An object that
the reference policy fails to turn into a tool is drawn again; the manifest says how often that happened.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from evaluator.engines.worker import die_with
from evaluator.scenarios import SPLITS, manifest_path, update_manifest, write_list
from evaluator.sim.parameters import WORLD, parameters_hash
from evaluator.sim.reference import prepare
from evaluator.sim.simulator import Simulator
from evaluator.sim.spawn import episode_generator
from rema_data.errors import InputError
from rema_data.schema import TASKS, Scenario, check_task

__all__ = ["COUNTS", "ROOT_SEED", "draw_scenario", "generate_list", "write_lists"]

ROOT_SEED = 2112_00359
"""Root of every frozen list; ``test`` and ``val`` are separate domains of it, and collection has a third."""
COUNTS = {"test": 10_000, "val": 2_000}
_CHUNK = 50


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


def write_lists(
    version: str,
    tasks: tuple[str, ...] = tuple(TASKS),
    counts: dict[str, int] | None = None,
    workers: int = 2,
    advance: Callable[[str, int], None] = lambda name, count: None,
) -> Path:
    """Write a new version of the scenario lists and its manifest; a list that is there is kept, never changed.

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
            drawn: list[Drawn] = []
            for item in generate_list(task, split, count, workers):
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
            )
    return manifest
