"""A quick look at a policy: scenarios in the order of the list, until it is better or worse than another run.

The run grows in steps, in one folder. After each, the pairs so far are tested by a sequence that allows any number of
tests (``evaluator.statistics.sequential``). Such a run has no rank; evaluated again without --quick, it continues.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa

from evaluator.protocol import FIRST_LOOK
from evaluator.rollout.backend import Backend, default_backend
from evaluator.run.header import RUN_FILE, read_header
from evaluator.run.reading import read_run
from evaluator.run.run import Run
from evaluator.run.seal import SUMMARY_FILE
from evaluator.runner.config import EvaluationConfig, EvaluationResult
from evaluator.runner.run import run_evaluation
from evaluator.scenarios import load_list
from evaluator.statistics import QuickLook
from rema_data.errors import InputError
from rema_data.progress import Progress

__all__ = ["quick_evaluation"]


def quick_evaluation(
    config: EvaluationConfig,
    against: Path,
    progress: Progress | None = None,
    *,
    backend: Backend | None = None,
    read: Callable[[Path], Run] = read_run,
) -> EvaluationResult:
    """Evaluate a policy until it is better or worse than a finished run, or ``config.episodes`` are played.

    ``summary["stopped_early"]`` holds verdict, counts, and intervals that hold however often one tests. Nothing is
    repeated (``audit`` is null). ``read`` reads ``against``.

    Raises InputError where ``against`` was another evaluation or the output holds a full run, which would lose its
    rank; and what ``run_evaluation`` and ``read_run`` raise.
    """
    backend = backend or default_backend()
    reference = read(against)
    theirs = reference.outcomes

    def look(rows: pa.Table) -> dict[str, Any]:
        test = QuickLook()
        ours = rows["success"].to_pylist()
        for success, measured, other in zip(ours, theirs.eligible, theirs.success, strict=False):
            if success is not None and measured and test.add(success, bool(other)):
                break
        return {"against": reference.policy, **test.result().to_dict()}

    mine = {
        "task": config.task,
        "split": config.split,
        "protocol": config.protocol,
        "protocol_hash": backend.protocol_hash(config.task, config.protocol),
        "scenarios_hash": load_list(config.task, config.split, config.version).sha256,
    }
    for field, value in reference.comparable.items():
        if value != mine[field]:
            raise InputError(
                f"{reference.source} does not compare: its {field} is {value or 'not recorded'}, "
                f"here it is {mine[field]}",
                hint="give a run of the same task, split and protocol, made with this version",
                field=field,
            )
    recorded = read_header(config.output)[0]["episodes"] if (config.output / RUN_FILE).exists() else 0
    if (config.output / SUMMARY_FILE).exists() and not read_run(config.output).stopped_early:
        raise InputError(
            f"{config.output} holds a run that is not a quick look",
            hint=f"compare the two: rema compare {config.output} {against}; or choose another folder with --output",
            path=str(config.output),
        )
    last = min(config.episodes, max(len(theirs.success), recorded))  # beyond that there is nothing to compare with
    for episodes in _lengths(min(max(FIRST_LOOK, recorded), last), last):
        result = run_evaluation(
            replace(config, episodes=episodes, audit_share=0.0), progress, backend=backend, look=look
        )
        if result.summary["stopped_early"]["decided_at"] is not None:
            break
    return result


def _lengths(first: int, last: int) -> Iterator[int]:
    """``first``, doubled until ``last``, which is the final one."""
    while first < last:
        yield first
        first *= 2
    yield last
