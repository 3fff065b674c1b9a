"""The content of the page besides groups and pictures: remarks, failures, funnel, timings, provenance."""

from __future__ import annotations

import hashlib
from collections import Counter
from typing import Any

import numpy as np

from evaluator.protocol import protocol, protocol_hash
from evaluator.report.breakdown import Group
from evaluator.run.run import Run
from evaluator.run.summary import PHASES
from evaluator.sim.kinds import KINDS
from evaluator.statistics import clopper_pearson, format_rate, percent, rate_interval
from rema_data.schema import TASKS

__all__ = [
    "criteria",
    "failures",
    "faults",
    "funnel",
    "provenance",
    "remarks",
    "segments",
    "step_name",
    "timings",
]

_UNKNOWN = "not recorded"


def step_name(task: str, step: int) -> str:
    """``2: grasp with the gripper``, counted from 1."""
    kind = TASKS[task][step]
    return f"{step + 1}: {kind.primitive.value} with {KINDS[kind].acting}"


def remarks(run: Run) -> list[str]:
    """Sentences without which the rate could be misread."""
    counts, found = run.counts, []
    eligible = counts.eligible
    if run.tag == "privileged":
        found.append("The policy is privileged: it is shown the true poses and shapes.")
    if eligible and counts.successes in (0, eligible):
        _, bound = clopper_pearson(0, eligible)
        word = "failed" if counts.successes else "succeeded"
        found.append(
            f"No episode {word}. That does not show that none ever will: the 95 % Clopper-Pearson interval of "
            f"the rate at which they do ends at {percent(bound)} %."
        )
    if counts.policy_errors:
        found.append(
            f"{counts.policy_errors:,} answers of the policy were faults: they count as failures of their episodes."
        )
    if counts.infra_errors and counts.bounds is not None:
        low, high = counts.bounds
        found.append(
            f"{counts.infra_errors:,} episodes were lost to the infrastructure and are in no rate. With any outcome "
            f"of theirs, the rate is between {percent(low)} and {percent(high)} %."
        )
    missing = counts.episodes - eligible - counts.infra_errors
    if missing:
        found.append(
            f"{missing:,} episodes are not eligible: they were not measured, or their scenario has no tools for this "
            "protocol."
        )
    if run.nondeterministic:
        found.append(
            f"{run.nondeterministic:,} steps were simulated twice with different outcomes: do not use these numbers."
        )
    if run.stopped_early:
        found.append("The run was stopped early, after looking at its rate: the interval does not hold for it.")
    if run.audit is not None:
        audit = run.audit
        found.append(
            f"{audit.actions:,} answers of the policy were asked for again: {audit.action_flips:,} differed. "
            f"{audit.outcomes:,} actions were simulated again: {audit.outcome_flips:,} outcomes differed."
        )
    segments = run.header["segments"]
    if any(segment.get("dirty") for segment in segments):
        found.append("The code was changed against its commit while this was computed.")
    if len({str((segment.get("machine"), segment.get("versions"))) for segment in segments}) > 1:
        found.append("The run was computed on different machines or with different versions: see provenance.")
    return found


def failures(run: Run) -> list[Group]:
    """Failure labels, the commonest first; ``successes`` counts the episodes that failed so."""
    eligible, labels = run.counts.eligible, run.counts.failures
    ordered = sorted(labels.items(), key=lambda item: (-item[1], item[0]))
    return [Group(label, eligible, count, *rate_interval(count, eligible)) for label, count in ordered]


def funnel(run: Run) -> list[dict[str, Any]]:
    """How many episodes reached and passed each step of an end-to-end run of several steps; nothing for other runs."""
    steps = run.counts.funnel
    return [
        {
            "name": step_name(run.task, step.step),
            "attempted": step.attempted,
            "succeeded": step.succeeded,
            "rate": step.succeeded / max(1, step.attempted),
            "text": format_rate(step.succeeded, step.attempted),
        }
        for step in (steps if len(steps) > 1 else ())
    ]


def faults(run: Run) -> list[tuple[str, int, str]]:
    """What the policy did instead of answering, the most common first: reason, count and the words of one."""
    rows = run.faults()
    counts = Counter(str(row["reason"]) for row in rows)
    examples = {str(row["reason"]): str(row["detail"] or "") for row in reversed(rows)}
    return [(reason, count, examples[reason]) for reason, count in counts.most_common()]


def timings(run: Run) -> dict[str, Any]:
    """Wall time in words and by phase (its start and length are shares of the whole), the simulator's time by step."""
    seconds, speed = run.summary["seconds"], run.summary["episodes_per_second"]
    total = seconds["total"]
    text = "No process of this run recorded its time."
    phases = []
    if total:
        workers = ", ".join(
            str(count) for count in sorted({segment.get("workers", 1) for segment in run.header["segments"]})
        )
        text = f"{_time(total)} in all, {speed:,.1f} episodes a second, workers: {workers}."
        named = {name: seconds.get(name, 0.0) for name in PHASES if name != "total"}
        named["other"] = max(0.0, total - sum(named.values()))
        whole, start = sum(named.values()), 0.0
        for name, value in named.items():
            if not value:
                continue
            phases.append({"name": name, "text": _time(value), "start": start, "share": value / whole})
            start += value / whole
    steps = []
    for step in sorted({row["step"] for row in run.timings}):
        rows = [row for row in run.timings if row["step"] == step]
        values = np.array([row["seconds"] for row in rows])
        spans = [*np.quantile(values, (0.5, 0.95)), values.max()]
        cells = [f"{len(rows):,}", *(f"{span:.3f}" for span in spans), _time(float(values.sum()))]
        cells += [str(len({row["worker"] for row in rows})), str(sum(row["attempt"] > 1 for row in rows))]
        steps.append((step_name(run.task, step), cells))
    return {"text": text, "phases": phases, "steps": steps}


def _time(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    minutes = seconds / 60
    return f"{minutes:.1f} min" if minutes < 120 else f"{minutes / 60:.1f} h"


def provenance(run: Run) -> list[tuple[str, str]]:
    """Everything that identifies the run."""
    policy, found = run.header["policy"], run.provenance
    results = run.results_path
    return [
        ("policy", f"{run.policy} ({policy.get('file', _UNKNOWN)}, class {policy.get('class_name', _UNKNOWN)})"),
        ("policy digest", found.policy_digest),
        ("task, split, protocol", f"{run.task}, {run.split}, {run.protocol}"),
        ("protocol hash", found.protocol_hash),
        ("scenario list", f"{run.rows[0]['scenario'].rpartition('/')[0]}, first {run.counts.episodes:,}"),
        ("scenarios hash", found.scenarios_hash),
        ("simulator", ", ".join(f"{name} {value}" for name, value in found.fingerprint.items())),
        (results.name, f"sha256 {hashlib.sha256(results.read_bytes()).hexdigest()}"),
        *([("seal", found.seal)] if found.seal else []),
    ]


def segments(run: Run) -> dict[str, Any]:
    """The processes that computed the run: names of the columns, and a row each."""
    rows = []
    for segment in run.header["segments"]:
        machine, versions, seconds = (segment.get(name) or {} for name in ("machine", "versions", "seconds"))
        row = {
            "segment": segment.get("number", ""),
            "started": str(segment.get("started", _UNKNOWN)).replace("T", " "),
            "episodes": f"{segment['finished']:,}" if "finished" in segment else "stopped",
        }
        row |= {name: segment.get(name, _UNKNOWN) for name in ("engine", "workers", "device")}
        row |= {
            "seconds": _time(seconds["total"]) if "total" in seconds else _UNKNOWN,
            "processor": f"{machine.get('processor', _UNKNOWN)}, {machine.get('cores', '?')} cores, "
            f"{machine.get('system', '')} {machine.get('architecture', '')}",
            "versions": ", ".join(f"{name} {number}" for name, number in versions.items()),
            "commit": str(segment.get("commit") or _UNKNOWN)[:12] + (", changed" if segment.get("dirty") else ""),
        }
        rows.append(row)
    return {"names": list(rows[0]) if rows else [], "rows": [row.values() for row in rows]}


def criteria(run: Run) -> list[str]:
    """What counted as success, step by step; nothing where this installation has another protocol."""
    if protocol_hash(run.task, run.protocol) != run.provenance.protocol_hash:
        return []
    steps = protocol(run.task, run.protocol)["steps"]
    return [f"{step_name(run.task, number).partition(': ')[2]}: {steps[number]['success']}" for number in run.steps]
