"""A first look at a policy: scenarios in the order of the list, until they tell it from a run of another one.

The run grows in steps, in one folder; at each the pairs so far are tested by a sequence that may be looked at as often
as one likes (``evaluator.statistics.sequential``). Such a run has no rank: evaluated again without a look, it goes on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa

from evaluator.comparison import check_comparable, paired_outcomes
from evaluator.evidence.header import RUN_FILE, read_header
from evaluator.runner.backend import Backend
from evaluator.runner.config import EvaluationConfig, EvaluationResult, ProgressSink
from evaluator.runner.run import run_evaluation
from evaluator.scored import read_run
from evaluator.statistics import QuickLook

__all__ = ["FIRST_LOOK", "quick_evaluation"]

FIRST_LOOK = 100
"""Episodes before the first look; every later one is after twice as many."""


def quick_evaluation(
    config: EvaluationConfig,
    against: Path,
    progress: ProgressSink | None = None,
    *,
    backend: Backend | None = None,
) -> EvaluationResult:
    """Evaluate a policy until it is better or worse than a finished run, or ``config.episodes`` are played.

    Parameters
    ----------
    config : EvaluationConfig
    against : Path
        Folder of a run of the same task, split and protocol.
    progress : ProgressSink, optional
    backend : Backend, optional

    Returns
    -------
    EvaluationResult
        ``summary["stopped_early"]`` says what the pairs tell: verdict, counts, and intervals that hold however often
        one looked. Nothing is repeated (``audit`` is null).

    Raises
    ------
    InputError
        The other run does not compare: it is of another task, split, protocol or scenario list.
    MissingFileError
        The other run has no outcomes.
    RemaError
        As ``run_evaluation``.
    """
    reference = read_run(against)
    theirs = paired_outcomes(reference)

    def look(rows: pa.Table) -> dict[str, Any]:
        test = QuickLook()
        ours = rows["success"].to_pylist()
        for success, measured, other in zip(ours, theirs.eligible, theirs.success, strict=False):
            if success is not None and measured and test.add(success, bool(other)):
                break
        return {"against": reference.policy, **test.result().to_dict()}

    recorded = read_header(config.output)[0]["episodes"] if (config.output / RUN_FILE).exists() else 0
    for episodes in _lengths(max(FIRST_LOOK, recorded), config.episodes):
        result = run_evaluation(
            replace(config, episodes=episodes, audit_share=0.0), progress, backend=backend, look=look
        )
        check_comparable(read_run(result.folder), reference)
        if result.summary["stopped_early"]["decided_at"] is not None:
            break
    return result


def _lengths(first: int, last: int) -> Iterator[int]:
    """``first``, doubled until ``last``, which is the final one."""
    while first < last:
        yield first
        first *= 2
    yield last
