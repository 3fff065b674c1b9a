"""A generalisation suite: a folder of frozen lists like the clean ones, whose scenarios belong to cells.

A cell is (task, axis, level). All cells of a task are one list, in an order that says nothing about them, so that a
policy is never told in which cell it is. Every axis has clean scenarios of its own, which its levels share: cells are
paired with each other, and with a clean run.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evaluator.scenarios.axes import AXES, Draw
from evaluator.scenarios.drawn import keep, kept, work_folder
from evaluator.scenarios.generation import Drawn, check_kind, named_list, write_named
from evaluator.scenarios.lists import load_list, manifest_path
from evaluator.scenarios.suites import SUITE, Cell, cells
from evaluator.sim.kinds import kind_of
from evaluator.sim.observation import observation_sha256, observe
from evaluator.sim.parameters import WORLD
from evaluator.sim.reach import valid_actions
from evaluator.sim.simulator import Simulator, process_simulator
from evaluator.sim.varied import standing
from rema_data import grid
from rema_data.errors import InputError
from rema_data.interrupts import check
from rema_data.progress import Progress, Silent
from rema_data.schema import TASK_NUMBERS, TASKS, Scenario
from rema_data.storage import write_atomic
from rema_data.variation import Variation

__all__ = ["CELL", "draw_suite", "shuffled", "vary"]

CELL = {"test": 500, "val": 100}
"""Scenarios of a cell."""
ROOT_SEED = 2112_00360
_DOMAIN = 0
_SPLITS = {"test": 0, "val": 1}
_REDRAWS = 50
_CHUNK = 20
TRIES = 200
"""Actions that are tried on a scenario before it counts as one that cannot be solved."""


def vary(simulator: Simulator, clean: Scenario, cell: Cell) -> Drawn:
    """The scenario of a cell that is made of a clean one: drawn until it can be solved.

    Where what is seen or done is not what is there, the clean scenario can be solved as it is.
    """
    axis = AXES[cell.axis]
    for redrawn in range(_REDRAWS):
        key = (_DOMAIN, TASK_NUMBERS[cell.task], axis.number, cell.level, _SPLITS[clean.split], clean.index, redrawn)
        rng = np.random.default_rng(np.random.SeedSequence(ROOT_SEED, spawn_key=key))
        made = axis.vary(clean, cell.level, Draw(rng, simulator))
        if made is None:
            continue
        named = dataclasses.replace(made.variation or Variation("", 0, clean.index), axis=cell.axis, level=cell.level)
        seen = observation_sha256(observe(dataclasses.replace(made, variation=named).last_situation()))
        made = dataclasses.replace(made, variation=dataclasses.replace(named, seen=seen))
        if axis.noisy or solvable(simulator, made, rng):
            return Drawn(made, redrawn)
    raise InputError(
        f"no scenario of {cell.axis}, level {cell.level}, could be made of {cell.task}/{clean.split}/{clean.index}",
        hint="make the level easier",
    )


def solvable(simulator: Simulator, scenario: Scenario, rng: np.random.Generator) -> bool:
    """Whether one of ``TRIES`` actions near the objects solves a scenario: a bound from below."""
    situation = scenario.last_situation()
    return any(simulator.run(situation, action).success for action in promising(scenario, rng))


def promising(scenario: Scenario, rng: np.random.Generator) -> Iterator[int]:
    """``TRIES`` valid actions: those of the reference policy, then random ones near what it aims at."""
    situation = scenario.last_situation()
    kind = kind_of(situation)
    valid = valid_actions(scenario.task, situation.step).reshape(-1)
    tried = 0
    for target in standing(situation):
        for action in kind.candidates(target, valid, rng, WORLD):
            if tried < TRIES // 4:
                tried += 1
                yield action
    actions = np.flatnonzero(valid)
    x, y, _ = grid.to_world(actions)
    aims = [kind.aim(target) for target in standing(situation)]
    away = np.min([np.hypot(x - aim_x, y - aim_y) for aim_x, aim_y in aims], axis=0)
    weights = np.exp(-((away / 0.04) ** 2))
    chosen = rng.choice(len(actions), size=TRIES - tried, replace=False, p=weights / weights.sum())
    yield from (int(actions[one]) for one in chosen)


def _vary_chunk(job: tuple[Sequence[Scenario], Cell]) -> list[Drawn]:
    clean, cell = job
    return [vary(process_simulator(), one, cell) for one in clean]


def shuffled(count: int, task: str, split: str) -> list[int]:
    """An order of a list that says nothing about its cells: by hash."""
    return sorted(range(count), key=lambda n: hashlib.blake2b(f"{task}/{split}/{n}".encode()).digest())


def draw_suite(
    version: str,
    pool: Executor,
    tasks: Sequence[str] = tuple(TASKS),
    size: Mapping[str, int] | None = None,
    *,
    identity: str = "",
    progress: Progress | None = None,
) -> Path:
    """Write the lists of a suite and their manifest, ``manifests/scenarios/VERSION``; a list that is there stays.

    ``size`` has the scenarios of a cell in each split, by default ``CELL``; ``identity`` is that of the code that
    draws. What was drawn before an interruption is not drawn again. Returns the manifest's path. Raises InputError,
    before anything is written, for a size that the clean lists are too short for, and for a version of clean lists.
    """
    size = size or CELL
    _check_size(size, tasks)
    sink, manifest = progress or Silent(), manifest_path(version)
    check_kind(manifest, version, suite=True)
    if not manifest.exists():
        axes = {
            axis.name: {"title": axis.title, "levels": axis.levels, "tasks": axis.tasks, "counts": axis.counts}
            for axis in AXES.values()
        }
        manifest.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(manifest, json.dumps({"version": version, SUITE: axes, "lists": {}}, indent=2) + "\n")
    for task in tasks:
        for split, count in size.items():
            entry = named_list(manifest, task, split)
            if entry is not None and (manifest.parent / entry["file"]).exists():
                continue
            work = work_folder(manifest, task, split)
            parts = [
                _Part(cell, start, min(start + _CHUNK, first + count))
                for cell in cells(task)
                for first in (AXES[cell.axis].number * count,)
                for start in range(first, first + count, _CHUNK)
            ]
            sink.phase(f"{task}/{split}", sum(part.stop - part.start for part in parts))
            own = work / hashlib.sha256(identity.encode()).hexdigest()[:16]
            drawn = [one for chunk in _drawn(parts, split, pool, own, sink) for one in chunk]
            order = shuffled(len(drawn), task, split)
            ordered = [
                one._replace(scenario=dataclasses.replace(one.scenario, index=new))
                for new, one in enumerate(drawn[old] for old in order)
            ]
            again = Counter({f"{part.cell.axis} {part.cell.level}": 0 for part in parts})
            for one in drawn:
                assert one.scenario.variation is not None
                again[f"{one.scenario.variation.axis} {one.scenario.variation.level}"] += one.redrawn
            domain = f"{ROOT_SEED}/{split}"
            write_named(manifest, version, ordered, entry, domain, redrawn_by_cell=dict(again))
            shutil.rmtree(work, ignore_errors=True)
    return manifest


def _check_size(size: Mapping[str, int], tasks: Sequence[str]) -> None:
    """Raise InputError where a cell would have no scenario, or a clean list too few for the cells of every axis."""
    for task in tasks:
        places = 1 + max(AXES[cell.axis].number for cell in cells(task))
        for split, count in size.items():
            most = len(load_list(task, split).scenarios) // places
            if not 1 <= count <= most:
                raise InputError(
                    f"cells of {count} scenarios cannot be made of {task}/{split}: a cell has 1 to {most}",
                    hint=f"give 1 to {most} scenarios for {split}",
                    task=task,
                    split=split,
                )


class _Part(NamedTuple):
    """Some scenarios of a cell: those that are made of the clean ones ``start`` to ``stop``."""

    cell: Cell
    start: int
    stop: int

    @property
    def name(self) -> str:
        return f"{self.cell.axis}-{self.cell.level}-{self.start:05d}-{self.stop:05d}"


def _drawn(parts: Sequence[_Part], split: str, pool: Executor, work: Path, sink: Progress) -> Iterator[list[Drawn]]:
    """What belongs to each part, in order; what is not in the work folder is drawn, and kept there."""
    task = parts[0].cell.task
    clean = load_list(task, split).scenarios
    found = {part: kept(work, part.name, task, split) for part in parts}
    missing = [part for part, there in found.items() if there is None]
    made = pool.map(_vary_chunk, [(clean[part.start : part.stop], part.cell) for part in missing])
    for part in parts:
        chunk = found[part]
        if chunk is None:
            chunk = next(made)
            keep(work, part.name, chunk)
        check()
        sink.advance(len(chunk))
        yield chunk
