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
from rema_data.schema import TASKS, skill

__all__ = ["Statistics", "StepCount", "TaskTotal", "count"]


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
        } | ({} if self.where is None else {"where": self.where})


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
    for block, table in zip(here, _tables(release, here, where), strict=True):
        rows += _count_block(block, table)
        episodes[block.task] += len(np.unique(table["episode"].to_numpy()))
    return Statistics(
        release.manifest.name,
        release.manifest.sha256,
        tuple(rows),
        missing,
        release.missing_hint(missing) if missing else "",
        episodes,
        where,
    )


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
