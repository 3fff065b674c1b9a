"""A release beside the upper half of the paper's Table 2, and why the two do not count alike."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from rema_data.manifests import manifests_dir, read_manifest
from rema_data.schema import TASKS
from rema_data.statistics.count import Statistics, StepCount

__all__ = ["Comparison", "Counts", "PaperRow", "compare", "published_counts"]

RANDOM = "random"
"""Name of the random policy in the tables of a release."""
EPISODES_A_ROUND = 12_000
"""Episodes of a task in a round of the paper, validation included (paper, "ReMa Dataset")."""
ROUNDS = {"grasp": 3, "push": 2, "grasp_grasp": 2, "grasp_push": 2}
"""Rounds in which the paper collected a task (paper, "ReMa Dataset")."""

_EARLIER = {"grasp": "tool picks", "grasp_grasp": "tool pinches"}
"""What a step before the last one is called, by its skill."""


@dataclass(frozen=True, slots=True)
class Counts:
    """Positives and negatives."""

    positives: int
    negatives: int

    @property
    def rows(self) -> int:
        """Both together."""
        return self.positives + self.negatives

    def __add__(self, other: Counts) -> Counts:
        return Counts(self.positives + other.positives, self.negatives + other.negatives)


@dataclass(frozen=True, slots=True)
class PaperRow:
    """One line of the comparison."""

    name: str  # a task, or what else is counted
    paper: Counts | None  # None where there is nothing to compare with
    ours: Counts | None


@dataclass(frozen=True, slots=True)
class Comparison:
    """Table 2 beside a release."""

    tasks: tuple[PaperRow, ...]  # last steps: the rows of a task
    total: PaperRow  # their sum
    earlier: tuple[PaperRow, ...]  # steps before the last one, by skill: tool picks (grasps) and tool pinches
    executed: PaperRow  # every executed step: the two sums
    remarks: tuple[str, ...]  # why the paper's rows are neither episodes nor steps

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        return asdict(self)


def published_counts() -> dict[str, Counts]:
    """Upper half of the paper's Table 2, by task.

    Raises
    ------
    MissingFileError, IntegrityError
        The file of the published numbers is not there, or cannot be read.
    """

    def counts(content: Any) -> dict[str, Counts]:
        positives, negatives = content["dataset"]["positives"], content["dataset"]["negatives"]
        return {task: Counts(int(positives[task]), int(negatives[task])) for task in ROUNDS}

    return read_manifest(manifests_dir() / "published" / "table2.json", "the table of published numbers", counts)


def compare(statistics: Statistics) -> Comparison:
    """Put a release beside the paper's table.

    Raises
    ------
    MissingFileError, IntegrityError
        See ``published_counts``.
    """
    paper = published_counts()
    totals = {row.task: Counts(row.positives, row.negatives) for row in statistics.totals()}
    tasks = tuple(
        PaperRow(task, paper.get(task), totals.get(task)) for task in TASKS if task in paper or task in totals
    )
    earlier: dict[str, Counts] = {}
    for row in statistics.steps:
        if not row.last:
            earlier[row.skill] = earlier.get(row.skill, Counts(0, 0)) + Counts(row.positives, row.negatives)
    ours = sum(totals.values(), Counts(0, 0))
    return Comparison(
        tasks,
        PaperRow("last steps", sum(paper.values(), Counts(0, 0)), ours),
        tuple(PaperRow(_EARLIER.get(skill, skill), None, counts) for skill, counts in earlier.items()),
        PaperRow("executed steps", None, sum(earlier.values(), ours)),
        (*_remarks(paper), *_rates_remark(statistics)),
    )


def executed_steps(rows: dict[str, int], episodes: dict[str, int]) -> dict[str, float]:
    """Steps that the paper's episodes must have executed, estimated: it does not print them.

    Of a task with several steps, ``rows`` episodes reached the last one. Where more than one pick comes before it, all
    picks are taken to succeed equally often.
    """
    found = {}
    for task, count in rows.items():
        picks = len(TASKS[task]) - 1
        rate = (count / episodes[task]) ** (1 / picks) if picks else 1.0
        found[task] = math.fsum(episodes[task] * rate**step for step in range(picks + 1))
    return found


def _remarks(paper: dict[str, Counts]) -> tuple[str, ...]:
    """The count puzzle of Table 2, in sentences whose numbers all follow from the table."""
    rows = {task: counts.rows for task, counts in paper.items()}
    episodes = {task: rounds * EPISODES_A_ROUND for task, rounds in ROUNDS.items()}
    executed = executed_steps(rows, episodes)
    picks = math.fsum(executed.values()) - sum(rows.values()) + rows["grasp"] - episodes["grasp"]
    extra = rows["grasp"] - episodes["grasp"]
    parts = " + ".join(f"{task} {_thousands(value)}" for task, value in executed.items())
    return (
        f"The paper's rows sum to {sum(rows.values()):,}; it collected {sum(episodes.values()):,} episodes. Its rows "
        "are neither episodes nor executed steps.",
        f"push: {rows['push']:,} rows of {episodes['push']:,} episodes: one row an episode, training and validation "
        "together.",
        f"grasp_grasp, grasp_push: {rows['grasp_grasp']:,} and {rows['grasp_push']:,} rows of "
        f"{episodes['grasp_grasp']:,} and {episodes['grasp_push']:,} episodes: those that reached the last step.",
        f"grasp: {rows['grasp']:,} rows, {extra:,} more than its {episodes['grasp']:,} episodes: it counts some tool "
        f"picks of the other tasks, but not all of them (about {_thousands(picks)}).",
        f"Every executed step of the paper's episodes would be about {_thousands(math.fsum(executed.values()))}: "
        f"{parts}. The picks of grasp_grasp are estimated from the rows that reached its end.",
        "Ours counts the last steps of a task as the rows of the task, and shows the steps before them, tool picks "
        "among them, in rows of their own. Training and validation are counted together.",
    )


def _rates_remark(statistics: Statistics) -> Iterator[str]:
    """Why the shares of positives differ, where a release has rounds of the random and of other policies."""
    last = [row for row in statistics.steps if row.last]
    newest = max((row.round for row in last), default=0)
    random = _rates([row for row in last if row.policy == RANDOM])
    ours = _rates([row for row in last if row.round == newest and row.policy != RANDOM])
    if random and ours:
        yield (
            "The shares of positives follow from who collected: last steps that the random policy played succeed in "
            f"{random}; those of round {newest}, by other policies, in {ours}."
        )


def _rates(rows: Sequence[StepCount]) -> str:
    """Shares of positives by task, as text."""
    found = {task: [row for row in rows if row.task == task] for task in TASKS}
    return ", ".join(
        f"{task} {100 * sum(row.positives for row in own) / reached:.1f} %"
        for task, own in found.items()
        if (reached := sum(row.reached for row in own))
    )


def _thousands(value: float) -> str:
    return f"{value / 1000:.1f}K" if value < 100_000 else f"{value / 1000:.0f}K"
