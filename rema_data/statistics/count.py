"""Positives and negatives of a release by round, task, split and step.

An episode counts once at every step that it executed: it *reaches* the step, which succeeds (positive) or fails
(negative, and the episode ends). A row of a *task* is an episode that reached the task's last step.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, SupportsIndex

import numpy as np
import pyarrow as pa

from rema_data.query import steps_that_meet
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import BlockEntry
from rema_data.schema import TASK_NUMBERS, TASKS, skill
from rema_data.store.columns import VARIATION, may_vary
from rema_data.store.tables import variation_of

__all__ = ["AxisCount", "Statistics", "StepCount", "TaskTotal", "count"]


class _Counted:
    """What is counted of a step: the episodes that reached it, and those in which it succeeded."""

    __slots__ = ()
    reached: int
    positives: int

    @property
    def negatives(self) -> int:
        """Episodes that ended here with a failure."""
        return self.reached - self.positives


@dataclass(frozen=True, slots=True)
class StepCount(_Counted):
    """One step of one block."""

    round: int
    task: str
    split: str
    step: int  # position in the task, from 0
    last: bool  # its success is the success of the task
    skill: str  # the task whose last step is of this kind; a tool pick is a ``grasp``
    policy: str  # of this step; several names are joined by ``+``
    reached: int  # episodes that executed the step
    positives: int  # those in which it succeeded


@dataclass(frozen=True, slots=True)
class AxisCount(_Counted):
    """The last steps of a task that are varied alike, over all rounds and splits that are on this machine."""

    task: str
    axis: str  # of the suites; empty for clean episodes
    level: int  # from 1; 0 for clean episodes
    episodes: int
    reached: int  # last steps that were executed
    positives: int


@dataclass(frozen=True, slots=True)
class TaskTotal(_Counted):
    """One task over all rounds and splits that are on this machine."""

    task: str
    episodes: int
    reached: int  # last steps that were executed
    positives: int
    executed: int  # steps of all positions


@dataclass(frozen=True)
class Statistics:
    """What a release holds, or some of it."""

    release: str
    sha256: str
    steps: tuple[StepCount, ...]  # of the blocks that are on this machine, in the order of the manifest
    missing: tuple[BlockEntry, ...]  # blocks that are not, whose steps are not known
    fix: str = ""  # the command that brings the missing blocks; empty where there are none
    episodes: Mapping[str, int] = field(default_factory=dict)  # by task: those of which a step is counted
    where: str | None = None  # the condition that a step meets to be counted
    axes: tuple[AxisCount, ...] = ()  # by task, axis and level; empty where no counted episode is varied

    def totals(self) -> tuple[TaskTotal, ...]:
        """Sums by task, in the order of ``TASKS``."""
        by_task = {task: [row for row in self.steps if row.task == task] for task in TASKS}
        return tuple(_total(task, self.episodes.get(task, 0), rows) for task, rows in by_task.items() if rows)

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain dictionaries and numbers, ready for JSON."""
        return {
            "release": self.release,
            "sha256": self.sha256,
            "steps": [asdict(row) | {"negatives": row.negatives} for row in self.steps],
            "tasks": [asdict(row) | {"negatives": row.negatives} for row in self.totals()],
            "missing": [asdict(block) for block in self.missing],
            **({} if self.where is None else {"where": self.where}),
            **({"axes": [asdict(row) | {"negatives": row.negatives} for row in self.axes]} if self.axes else {}),
        }


def _total(task: str, episodes: int, rows: list[StepCount]) -> TaskTotal:
    last = [row for row in rows if row.last]
    return TaskTotal(
        task,
        episodes=episodes,
        reached=sum(row.reached for row in last),
        positives=sum(row.positives for row in last),
        executed=sum(row.reached for row in rows),
    )


def count(
    release: ReleaseFolder,
    tasks: Iterable[str] | None = None,
    rounds: Iterable[int] | SupportsIndex | None = None,
    split: str | Iterable[str] | None = None,
    where: str | None = None,
) -> Statistics:
    """Count the steps of a release, from the tables that are on this machine.

    ``tasks``, ``rounds`` and ``split`` choose blocks, by default all; ``where`` is a condition that a step meets to be
    counted (see ``rema_data.query``).

    Raises
    ------
    IntegrityError
        A table is damaged.
    InputError
        There is no such block, or the condition cannot be used.
    """
    chosen = release.manifest.select(tasks, rounds, split)
    present = {block.key for block in release.blocks()}
    here = [block for block in chosen if block.key in present]
    missing = tuple(block for block in chosen if block.key not in present)
    rows: list[StepCount] = []
    episodes: Counter[str] = Counter()
    axes = _Axes()
    for block, table in zip(here, _tables(release, here, where), strict=True):
        rows += _count_block(block, table)
        episodes[block.task] += len(np.unique(table["episode"].to_numpy()))
        if may_vary(release.manifest.schema_version):
            axes.add(block.task, release.block(block).episodes(), table)
    return Statistics(
        release.manifest.name,
        release.manifest.sha256,
        tuple(rows),
        missing,
        release.missing_hint(missing) if missing else "",
        episodes,
        where,
        axes.counts(),
    )


class _Axes:
    """Episodes by what is varied in them, gathered one block after the other."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, str, int], list[int]] = {}

    def add(self, task: str, episodes: pa.Table, steps: pa.Table) -> None:
        """Count the episodes of a block of which ``steps`` are counted."""
        last = steps.filter(steps["last"])
        won = dict(zip(last["episode"].to_pylist(), last["success"].to_pylist(), strict=True))
        counted = set(steps["episode"].to_pylist())
        for row in episodes.select(["task", "round", "split", "episode", VARIATION]).to_pylist():
            if row["episode"] in counted:
                variation, success = variation_of(row), won.get(row["episode"])
                cell = ("", 0) if variation is None else (variation.axis, variation.level)
                sums = self._found.setdefault((task, *cell), [0, 0, 0])
                for place, more in enumerate((True, success is not None, bool(success))):
                    sums[place] += more

    def counts(self) -> tuple[AxisCount, ...]:
        """By task, clean episodes first; nothing where all episodes are clean."""
        if not any(axis for _, axis, _ in self._found):
            return ()
        order = sorted(self._found, key=lambda cell: (TASK_NUMBERS[cell[0]], *cell[1:]))
        return tuple(AxisCount(*cell, *self._found[cell]) for cell in order)


def _tables(release: ReleaseFolder, blocks: Sequence[BlockEntry], where: str | None) -> Iterator[pa.Table]:
    """The steps of every block that meet a condition."""
    if where is None or not blocks:
        yield from (release.block(block).steps() for block in blocks)
        return
    tables = [(reader.episodes(), reader.steps()) for reader in map(release.block, blocks)]
    met = steps_that_meet(where, tables)
    for _, steps in tables:
        yield steps.filter(pa.array(met[: len(steps)]))
        met = met[len(steps) :]


def _count_block(block: BlockEntry, table: pa.Table) -> Iterator[StepCount]:
    step = table["step"].to_numpy()
    success = table["success"].to_numpy()
    kinds = TASKS[block.task]
    reached = np.bincount(step, minlength=len(kinds))
    positives = np.bincount(step[success], minlength=len(kinds))
    for number, kind in enumerate(kinds):
        yield StepCount(
            *block.key,
            step=number,
            last=number == len(kinds) - 1,
            skill=skill(kind),
            policy=block.policies[number],
            reached=int(reached[number]),
            positives=int(positives[number]),
        )
