"""The scores that the policy of a run gives its actions, asked for again, and its calibration.

A run records actions, not scores. A policy that has a method ``maps(observations)``, as the learned baselines do,
can be asked again: in a process of its own, in the sandbox that it was evaluated in.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from evaluator.policy import PolicyFault, PolicyHost, PolicySpec, digest
from evaluator.policy.output import printable
from evaluator.report.breakdown import Group, group
from evaluator.rollout.ask import question
from evaluator.rollout.backend import Backend, default_backend
from evaluator.rollout.blank import showing
from evaluator.run.run import Row, Run
from rema_data import grid
from rema_data.errors import RunMismatchError, SubmissionError
from rema_data.schema import Situation

__all__ = ["Bin", "Scored", "ask_scores", "calibration", "check_policy"]

BATCH = 16
CUTS = (0.2, 0.4, 0.6, 0.8)
"""Shares of the episodes at which the calibration is cut; equal scores stay together."""
_SAID = 1000  # characters of what it printed


@dataclass(frozen=True, slots=True)
class Scored:
    """Scores of one question."""

    chosen: float  # of the recorded action
    # float32 (64, 64): the highest of every place over its valid angles; NaN: none is valid
    best: npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Bin:
    """Episodes with similar scores: their mean score, and how often they succeeded."""

    score: float
    group: Group


def check_policy(run: Run, policy: PolicySpec, checkpoint: Path | None) -> None:
    """Refuse a policy that is not that of the run: a RunMismatchError where its digest differs."""
    got, recorded = digest(policy, checkpoint), run.provenance.policy_digest
    if got != recorded:
        raise RunMismatchError(
            f"{policy.name} is not the policy of {run.source}: its digest is {got[:12]}..., "
            f"that of the run {recorded[:12]}...",
            hint="name the policy and the --checkpoint that were evaluated, or leave --policy out",
            path=str(run.source),
            recorded=recorded,
            got=got,
        )


def ask_scores(
    policy: PolicySpec,
    questions: Sequence[tuple[Situation, int]],
    checkpoint: Path | None = None,
    device: str = "cpu",
    sandbox: str | None = None,
    *,
    protocol: str = "conditional",
    run: Path | None = None,
    note: Callable[[str], None] | None = None,
) -> list[Scored]:
    """Scores of some situations and of the actions that were taken in them.

    ``run`` is the folder whose outcomes the policy must not see; ``note`` gets the isolation level. Raises
    SubmissionError where the policy cannot be loaded, has no maps, or gave something else.
    """
    by_step: dict[tuple[str, int], list[int]] = {}
    for number, (situation, _) in enumerate(questions):
        by_step.setdefault((situation.task, situation.step), []).append(number)
    found: dict[int, Scored] = {}
    backend = showing(default_backend(), protocol)
    with PolicyHost(policy, checkpoint, device, run=run, sandbox=sandbox) as host:
        if note is not None:
            note(f"policy sandbox: {host.isolation}")
        for numbers in by_step.values():
            for start in range(0, len(numbers), BATCH):
                part = numbers[start : start + BATCH]
                found.update(zip(part, _ask(host, backend, [questions[number] for number in part]), strict=True))
    return [found[number] for number in range(len(questions))]


def _ask(host: PolicyHost, backend: Backend, questions: Sequence[tuple[Situation, int]]) -> list[Scored]:
    """Scores of some questions about the same step, put at once."""
    actions = np.array([action for _, action in questions])
    batch = question(backend, [situation for situation, _ in questions])
    scores = host.maps(batch)
    if isinstance(scores, PolicyFault):
        raise _no_maps(host, scores.detail)
    i, j, k = grid.decode(actions)
    if (k >= scores.shape[3]).any():
        raise _no_maps(host, "maps has no score for an angle that the policy chose")
    chosen = scores[np.arange(len(batch)), i, j, k]
    allowed = np.where(batch.valid[..., : scores.shape[3]], scores, np.float32(-np.inf)).max(axis=3)
    best = np.where(np.isfinite(allowed), allowed, np.float32(np.nan))
    return [Scored(float(one), places) for one, places in zip(chosen, best, strict=True)]


def _no_maps(host: PolicyHost, why: str) -> SubmissionError:
    said = printable(host.output[-_SAID:]).strip()
    return SubmissionError(
        f"policy {host.spec.name} gave no maps: {why}",
        hint=f"{said}\nfix {host.spec.path}, or leave --policy out".strip(),
        path=host.spec.path,
    )


def calibration(rows: Sequence[Row], step: int, scores: Sequence[float]) -> list[Bin]:
    """Success of ``step`` against ``scores`` (0..1, one a row), in groups of about equal size, lowest scores first."""
    if not rows:
        return []
    values = np.array(scores)
    places = np.searchsorted(np.quantile(values, CUTS), values, side="right")
    bins = []
    for place in range(len(CUTS) + 1):
        mine = places == place
        if mine.any():
            chosen = [
                {"success": row[f"step{step}_success"]} for row, kept in zip(rows, mine.tolist(), strict=True) if kept
            ]
            label = f"{values[mine].min():.3f} to {values[mine].max():.3f}"
            bins.append(Bin(float(values[mine].mean()), group(label, chosen)))
    return bins
