"""What the policy of a run thought of its actions: its scores, asked for again, and how they turned out.

A run records actions, not scores. A policy that has a method ``maps(observations)``, as the learned baselines do,
can be asked again in a process of its own (``score_child.py``), which runs with the rights of the user.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

import evaluator
from evaluator.policy.loading import PolicySpec, check_checkpoint, digest
from evaluator.report.breakdown import Group, group
from evaluator.report.finished import FinishedRun, Row
from evaluator.report.selection import spread
from evaluator.sim.observation import observe
from evaluator.sim.reach import valid_actions
from rema_data.errors import RunMismatchError, SubmissionError
from rema_data.schema import Scenario, Situation

__all__ = ["Bin", "Scored", "ask_scores", "calibration", "check_policy", "scored_episodes", "situation_of"]

BATCH = 16
CUTS = (0.2, 0.4, 0.6, 0.8)
"""Shares of the episodes at which the calibration is cut; equal scores stay together."""
_LIMIT_S = 3600.0


@dataclass(frozen=True, slots=True)
class Scored:
    """Scores of one question.

    Attributes
    ----------
    chosen : float
        Score of the recorded action.
    best : float32 (64, 64)
        Highest score of every place over its valid angles; NaN where none is valid.
    """

    chosen: float
    best: npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Bin:
    """Episodes with similar scores: their mean score, and how often they succeeded."""

    score: float
    group: Group


def check_policy(run: FinishedRun, policy: PolicySpec, checkpoint: Path | None) -> None:
    """Refuse a policy that is not the one of the run.

    Raises
    ------
    RunMismatchError
        Its digest is another one.
    MissingFileError
        Code or weights are not there.
    """
    got, recorded = digest(policy, checkpoint), run.summary["policy_digest"]
    if got != recorded:
        raise RunMismatchError(
            f"{policy.name} is not the policy of {run.path}: its digest is {got[:12]}..., "
            f"that of the run {str(recorded)[:12]}...",
            hint="name the policy and the --checkpoint that were evaluated, or leave --policy out",
            path=str(run.path),
            recorded=recorded,
            got=got,
        )


def scored_episodes(run: FinishedRun, count: int) -> list[Row]:
    """Episodes with an action for the first step of the policy, ``count`` at most, spread over the list."""
    step = run.steps[0]
    rows = [row for row in run.measured if row[f"step{step}_action"] is not None]
    return spread([row for row in rows if row[f"step{step}_success"] is not None], count)


def ask_scores(
    policy: PolicySpec, checkpoint: Path | None, device: str, questions: Sequence[tuple[Situation, int]]
) -> list[Scored]:
    """Scores of some situations and of the actions that were taken in them.

    Parameters
    ----------
    policy : PolicySpec
    checkpoint : Path or None
    device : str
        Handed to the policy.
    questions : sequence of (Situation, int)

    Raises
    ------
    SubmissionError
        The policy cannot be loaded, has no maps, or gave something else.
    """
    by_step: dict[tuple[str, int], list[int]] = {}
    for number, (situation, _) in enumerate(questions):
        by_step.setdefault((situation.task, situation.step), []).append(number)
    found: dict[int, Scored] = {}
    for numbers in by_step.values():
        with tempfile.TemporaryDirectory(prefix="rema-scores-") as folder:
            part = [questions[number] for number in numbers]
            found.update(zip(numbers, _ask(policy, checkpoint, device, part, Path(folder)), strict=True))
    return [found[number] for number in range(len(questions))]


def _ask(
    policy: PolicySpec,
    checkpoint: Path | None,
    device: str,
    questions: Sequence[tuple[Situation, int]],
    folder: Path,
) -> list[Scored]:
    """One process: some questions about the same step."""
    first = questions[0][0]
    seen = [observe(situation) for situation, _ in questions]
    weights = check_checkpoint(checkpoint)
    np.savez(
        folder / "questions.npz",
        scene=np.stack([one.scene_m() for one in seen]),
        end_effector=np.stack([one.end_effector() for one in seen]),
        valid=valid_actions(first.task, first.step),
        action=np.array([action for _, action in questions]),
        words=np.array([first.kind.primitive.value, first.kind.embodiment.value, first.task]),
        step=first.step,
        policy=np.array([str(policy.path), policy.class_name, device, "" if weights is None else str(weights)]),
        batch=BATCH,
    )
    root = Path(evaluator.__file__).resolve().parents[1]
    command = [sys.executable, "-P", "-m", "evaluator.report.score_child", "questions.npz", "answers.npz"]
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            env=_environment(root),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            timeout=_LIMIT_S,
        )
    except subprocess.TimeoutExpired as error:
        raise SubmissionError(
            f"policy {policy.name} gave no maps in {_LIMIT_S:g} s", hint="leave --policy out"
        ) from error
    if done.returncode:
        words = done.stderr.strip().splitlines() or [f"its process ended with {done.returncode}"]
        raise SubmissionError(
            f"policy {policy.name} gave no maps: {words[-1]}", hint=f"mend {policy.path}, or leave --policy out"
        )
    with np.load(folder / "answers.npz", allow_pickle=False) as answers:
        return [Scored(float(chosen), best) for chosen, best in zip(answers["chosen"], answers["best"], strict=True)]


def _environment(root: Path) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), *(path for path in sys.path if path)])}


def calibration(rows: Sequence[Row], step: int, scores: Sequence[float]) -> list[Bin]:
    """Scores against success: groups of about equal size, from the lowest scores to the highest.

    Parameters
    ----------
    rows : sequence of mapping
        Of ``episodes.parquet``.
    step : int
        The step that was scored; success is its own.
    scores : sequence of float
        Shares in 0..1, one a row.

    Returns
    -------
    list of Bin
        Empty where there are no rows.
    """
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


def situation_of(scenario: Scenario, run: FinishedRun) -> Situation:
    """The first situation in which the policy acted: it depends on the scenario alone."""
    return scenario.first_situation() if run.end_to_end else scenario.last_situation()
