"""Which episodes are shown: some successes and some of every failure, always the same ones of the same run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from evaluator.run.run import Row, Run

__all__ = ["SUCCESS", "Chosen", "choose", "spread"]

SUCCESS = "success"
"""Stands among the failure labels for the episodes that succeeded."""


@dataclass(frozen=True, slots=True)
class Chosen:
    """An episode of the gallery."""

    label: str  # ``success`` or the failure label
    rank: int  # position among the chosen ones of the label, from 0
    row: Row


def choose(run: Run, per_label: int) -> list[Chosen]:
    """At most ``per_label`` episodes of every label, spread over the list; successes, then failures by frequency."""
    by_label: dict[str, list[Row]] = {SUCCESS: []}
    for row in run.measured:
        by_label.setdefault(SUCCESS if row["success"] else row["failure"], []).append(row)
    order = sorted(by_label, key=lambda label: (label != SUCCESS, -len(by_label[label]), label))
    return [Chosen(label, rank, row) for label in order for rank, row in enumerate(spread(by_label[label], per_label))]


def spread(rows: Sequence[Row], count: int) -> list[Row]:
    """``count`` rows at even distances, or all where there are no more."""
    if count >= len(rows):
        return list(rows)
    return [rows[(2 * number + 1) * len(rows) // (2 * count)] for number in range(count)]
