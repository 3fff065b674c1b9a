"""Rows of the leaderboard: finished runs, and the paper's published rates for reference."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evaluator.policy.loading import OWN_PREFIX
from evaluator.statistics import wilson, z_against_published
from rema_data.errors import InputError, MissingFileError
from rema_data.manifests import manifests_dir
from rema_data.schema import TASKS

__all__ = ["PUBLISHED_REMARK", "Row", "find_runs", "leaderboard", "published_rows", "read_run", "remarks"]

PUBLISHED_REMARK = (
    "published: rates of the paper's Table 2, over more than 10,000 episodes each. Its scenes and its simulator are "
    "not ours, so z (same policy, ours minus published, in standard errors) says how close the worlds are, "
    "not who is better."
)
_SUMMARY_FIELDS = ("task", "policy", "protocol", "eligible", "successes", "policy_errors", "infra_errors", "failures")


@dataclass(frozen=True, slots=True)
class Row:
    """One policy on one task.

    Attributes
    ----------
    policy : str
    tag : str
        ``submitted``, ``learned`` (the built-in ``tae-*``), ``privileged``, ``random`` or ``published``.
    task, protocol : str
    successes : int or None
        Not published by the paper.
    episodes : int
        Eligible episodes: the denominator.
    rate : float or None
        Share in 0..1; None where no episode was eligible.
    ci95 : (float, float) or None
        Wilson interval.
    policy_errors, infra_errors : int
        Policy errors are failures and in the denominator, infrastructure errors are neither.
    failures : dict of str -> int
        Failed episodes by label.
    z : float or None
        Distance to the published rate of the same policy and task, in standard errors.
    fingerprint : str
        Of the protocol, the scenario list and the simulator: rows compare where it is equal. Empty if published.
    run : str
        The run folder.
    """

    policy: str
    tag: str
    task: str
    protocol: str
    successes: int | None
    episodes: int
    rate: float | None
    ci95: tuple[float, float] | None
    policy_errors: int = 0
    infra_errors: int = 0
    failures: dict[str, int] | None = None
    z: float | None = None
    fingerprint: str = ""
    run: str = ""


def leaderboard(runs: Sequence[Path], published: bool = True) -> list[Row]:
    """Rows of ``runs`` and of the paper, task by task, best first.

    Parameters
    ----------
    runs : sequence of Path
        Run folders with a ``summary.json``.
    published : bool
        Add the paper's rows: of the tasks that the runs are about, or of all where there is no run.

    Raises
    ------
    MissingFileError
        When a run has no summary.
    InputError
        When a summary cannot be read.
    """
    rows = [read_run(run) for run in runs]
    if published:
        tasks = {row.task for row in rows} or set(TASKS)
        rows += [row for row in published_rows() if row.task in tasks]
    order = list(TASKS)
    return sorted(rows, key=lambda row: (order.index(row.task), row.protocol, -(row.rate or 0.0), row.tag, row.policy))


def find_runs(folder: Path) -> list[Path]:
    """Run folders below ``folder`` that have a summary, sorted."""
    return sorted(path.parent for path in folder.glob("*/summary.json"))


def read_run(run: Path) -> Row:
    """The row of one run folder.

    Raises
    ------
    MissingFileError
        When it has no ``summary.json``.
    InputError
        When that is not the summary of a run.
    """
    path = run / "summary.json"
    if not path.is_file():
        hint = "finish it with `rema evaluate`" if run.is_dir() else "check the path"
        raise MissingFileError(f"{run} holds no finished run", hint=hint, path=path)
    try:
        summary = json.loads(path.read_text())
        missing = [field for field in _SUMMARY_FIELDS if field not in summary]
        if missing or summary["task"] not in TASKS:
            raise ValueError(f"without {', '.join(missing)}" if missing else f"of unknown task {summary['task']!r}")
        return _row(summary, run)
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(
            f"{path} is not the summary of a run: {error}", hint="evaluate the policy again", path=path
        ) from error


def _row(summary: dict[str, Any], run: Path) -> Row:
    successes, eligible = int(summary["successes"]), int(summary["eligible"])
    z, tag = None, _tag(summary)
    same = summary["protocol"] == "conditional" and tag != "submitted"  # a stranger's "joint.py" is not the paper's
    known = _published_rate(summary["policy"], summary["task"]) if same else None
    if known is not None and eligible:
        z, _ = z_against_published(successes, eligible, known)
    marks = [summary.get(name) for name in ("protocol_hash", "scenarios_hash", "fingerprint")]
    return Row(
        policy=summary["policy"],
        tag=tag,
        task=summary["task"],
        protocol=summary["protocol"],
        successes=successes,
        episodes=eligible,
        rate=successes / eligible if eligible else None,
        ci95=wilson(successes, eligible) if eligible else None,
        policy_errors=int(summary["policy_errors"]),
        infra_errors=int(summary["infra_errors"]),
        failures={str(label): int(count) for label, count in summary["failures"].items()},
        z=z,
        fingerprint=json.dumps(marks, sort_keys=True),
        run=str(run),
    )


def _tag(summary: dict[str, Any]) -> str:
    """What kind of contestant: who saw the ground truth is never called anything else."""
    if summary.get("privileged"):
        return "privileged"
    name = summary["policy"]
    ours = name.startswith(OWN_PREFIX) and ".py" not in name  # a stranger's tae-joint.py keeps its ending
    return {"random": "random", "scripted": "privileged"}.get(name, "learned" if ours else "submitted")


def published_rows() -> list[Row]:
    """The paper's Table 2, lower half."""
    table = _published()
    count = int(table["episodes"])
    rows = []
    for policy, rates in table["success_percent"].items():
        for task, percent in rates.items():
            interval = wilson(round(percent / 100 * count), count)
            rows.append(
                Row(policy, "published", task, table["protocol"], None, count, round(percent / 100, 6), interval)
            )
    return rows


def _published_rate(policy: str, task: str) -> float | None:
    """Published share in 0..1 of a built-in baseline, if there is one."""
    rates: dict[str, float] = _published()["success_percent"].get(policy, {})
    return rates[task] / 100 if task in rates else None


def _published() -> dict[str, Any]:
    path = manifests_dir() / "published" / "table2.json"
    if not path.is_file():
        raise MissingFileError(f"{path} does not exist", hint="install rema again", path=path)
    table: dict[str, Any] = json.loads(path.read_text())
    return table


def remarks(rows: Iterable[Row]) -> list[str]:
    """Sentences that belong under the table: what the published rows are, and which rows do not compare."""
    found = []
    listed = list(rows)
    if any(row.tag == "published" for row in listed):
        found.append(PUBLISHED_REMARK)
    for task, protocol in dict.fromkeys((row.task, row.protocol) for row in listed):
        marks = {row.fingerprint for row in listed if row.fingerprint and (row.task, row.protocol) == (task, protocol)}
        if len(marks) > 1:
            found.append(
                f"{task} ({protocol}): the runs differ in protocol, scenario list or simulator: "
                "do not compare their rates."
            )
    if any(row.infra_errors for row in listed):
        found.append("Infrastructure errors are in no denominator; the run's summary.json gives the rate's bounds.")
    return found
