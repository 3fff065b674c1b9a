"""Positives and negatives of a release by round, task, split and step.

An episode counts once at every step that it executed: it *reaches* the step, which succeeds (positive) or fails
(negative, and the episode ends). A row of a *task* is an episode that reached the task's last step.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import BlockEntry
from rema_data.schema import TASKS, skill
from rema_data.store.block import BlockReader

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
    """What a release holds."""

    release: str
    sha256: str
    steps: tuple[StepCount, ...]  # of the blocks that are on this machine, in the order of the manifest
    missing: tuple[BlockEntry, ...]  # blocks that are not, whose steps are not known
    fix: str = ""  # the command that brings the missing blocks; empty where there are none

    def totals(self) -> tuple[TaskTotal, ...]:
        """Sums by task, in the order of ``TASKS``."""
        by_task = {task: [row for row in self.steps if row.task == task] for task in TASKS}
        return tuple(_total(task, rows) for task, rows in by_task.items() if rows)

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain dictionaries and numbers, ready for JSON."""
        return {
            "release": self.release,
            "sha256": self.sha256,
            "steps": [asdict(row) | {"negatives": row.negatives} for row in self.steps],
            "tasks": [asdict(row) | {"negatives": row.negatives} for row in self.totals()],
            "missing": [asdict(block) for block in self.missing],
        }


def _total(task: str, rows: list[StepCount]) -> TaskTotal:
    last = [row for row in rows if row.last]
    return TaskTotal(
        task,
        episodes=sum(row.reached for row in rows if row.step == 0),
        reached=sum(row.reached for row in last),
        positives=sum(row.positives for row in last),
        executed=sum(row.reached for row in rows),
    )


def count(release: ReleaseFolder) -> Statistics:
    """Count the steps of a release, from the tables that are on this machine.

    Raises
    ------
    IntegrityError
        A table is damaged.
    """
    here = release.blocks()
    present = {block.key for block in here}
    missing = tuple(block for block in release.manifest.blocks if block.key not in present)
    return Statistics(
        release.manifest.name,
        release.manifest.sha256,
        tuple(row for block in here for row in _count_block(block, release.block(block))),
        missing,
        release.missing_hint(missing) if missing else "",
    )


def _count_block(block: BlockEntry, reader: BlockReader) -> Iterable[StepCount]:
    table = reader.steps()
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
