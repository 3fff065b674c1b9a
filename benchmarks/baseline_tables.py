"""The tables of docs/baselines.md: everything that ``benchmarks/baselines.py`` writes beside its figures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from scipy.stats import fisher_exact

from baselines.devices import LEARNED
from baselines.rounds.recursion_plan import RecursionPlan
from baselines.tae.checkpoint import load_checkpoint
from benchmarks.results import ROOT
from evaluator.leaderboard.published import published_rate
from evaluator.policy.shipped import shipped_policies
from evaluator.statistics import percent
from rema_data.release.folder import ReleaseFolder
from rema_data.schema import TASKS
from rema_data.statistics.paper import Comparison, Counts

PAPER_BY_ROUND = {1: 51.0, 2: 88.0}
"""Grasp, percent: the only rates after a round that the paper's text names (section 4.4)."""
POLICIES = ("random", "scripted", "tae-separate", "tae-joint")
LEVEL = 0.05

Summary = Mapping[str, Any]


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table, or a sentence where it has no row."""
    if not rows:
        return "Not measured yet."
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def rate(run: Summary) -> str:
    """Rate and interval of a run, percent."""
    low, high = run["ci95"]
    return f"{100 * run['success_rate']:.2f} [{100 * low:.2f}, {100 * high:.2f}]"


def rates_table(runs: Mapping[str, Summary], protocol: str) -> str:
    """One row a policy, one column a task; the paper's rates below ours."""
    tasks = list(TASKS) if protocol == "conditional" else [task for task in TASKS if len(TASKS[task]) > 1]
    rows = []
    for policy in POLICIES:
        own = {task: runs.get(f"{policy}-{task}-{protocol}") for task in tasks}
        if any(own.values()):
            rows.append([policy, *("" if run is None else rate(run) for run in own.values())])
            if protocol == "conditional":
                paper = [published_rate(policy, task) for task in tasks]
                rows.append(["*the paper's*", *("" if share is None else f"*{percent(share)}*" for share in paper)])
    return markdown(["policy", *tasks], rows)


def funnel_table(runs: Mapping[str, Summary]) -> str:
    """Steps of the end-to-end runs: reached, and succeeded."""
    rows = []
    for run in (run for run in runs.values() if run["protocol"] == "end-to-end"):
        for step in run["funnel"]:
            share = "" if step["rate"] is None else f"{100 * step['rate']:.1f} %"
            place = f"{step['step'] + 1} of {len(run['funnel'])}"
            rows.append([run["task"], run["policy"], place, f"{step['attempted']:,}", f"{step['succeeded']:,}", share])
    return markdown(["task", "policy", "step", "reached", "succeeded", "rate"], rows)


def of_plan(runs: Mapping[str, Summary], plan: RecursionPlan) -> dict[str, Summary]:
    """The kept runs that a page about a plan shows, by the names that its tables use: ``round-1-grasp-conditional``.

    A run of a learned policy is of the plan where its name begins with the plan's, or with the policy's while networks
    of the plan ship under it.
    """
    shipped = {policy: one.folder.partition("/")[0] for policy, one in shipped_policies().items()}
    found: dict[str, Summary] = {}
    for name, run in runs.items():
        if name.startswith(f"{plan.name}-"):
            own = name.removeprefix(f"{plan.name}-")
            found[own if own.startswith("round-") else f"tae-{own}"] = run
        elif run["policy"] not in LEARNED or (
            name.startswith(f"{run['policy']}-") and shipped.get(run["policy"]) == plan.name
        ):
            found.setdefault(name, run)
    return dict(sorted(found.items()))


def by_round(runs: Mapping[str, Summary], plan: RecursionPlan) -> dict[str, dict[int, Summary]]:
    """Runs of the networks after every round, by task; round 0 is the random policy, the last one the joint policy."""
    last = len(plan.rounds)
    found: dict[str, dict[int, Summary]] = {}
    for task in TASKS:
        names = {0: f"random-{task}-conditional", last: f"tae-joint-{task}-conditional"}
        names |= {number: f"round-{number}-{task}-conditional" for number in range(1, last)}
        own = {number: runs[name] for number, name in sorted(names.items()) if name in runs}
        if set(own) - {0}:
            found[task] = own
    return found


def collected_table(release: ReleaseFolder) -> str:
    """Success of the last steps while the data were collected, by round."""
    rows = []
    for block in release.manifest.blocks:
        if block.split == "train":
            share = f"{100 * block.positives / block.episodes:.1f} %"
            rows.append([str(block.round), block.task, ", ".join(block.policies), f"{block.episodes:,}", share])
    return markdown(["round", "task", "policy of every step", "episodes (train)", "succeeded"], rows)


def paper_by_round(task: str, last: int) -> dict[int, float]:
    """The paper's rates, percent, by round: 0 is its random policy, ``last`` its joint one."""
    ends = {0: published_rate("random", task), last: published_rate("tae-joint", task)}
    known = {number: 100 * share for number, share in ends.items() if share is not None}
    return known | (PAPER_BY_ROUND if task == "grasp" else {})


def rounds_table(found: Mapping[str, Mapping[int, Summary]], last: int) -> str:
    """Rates by round, one row a task."""
    rows = []
    for task, own in found.items():
        paper = paper_by_round(task, last)
        for number, run in own.items():
            shown = f"{paper[number]:g}" if number in paper else ""
            rows.append([task, str(number), f"{run['successes']:,} / {run['eligible']:,}", rate(run), shown])
    return markdown(["task", "after round", "k / n", "ours, % [95 %]", "paper, %"], rows)


def paper_table(comparison: Comparison) -> str:
    """The release beside the upper half of the paper's Table 2."""

    def shown(counts: Counts | None) -> list[str]:
        if counts is None:
            return ["", ""]
        share = f" ({100 * counts.positives / counts.rows:.1f} %)" if counts.rows else ""
        return [f"{counts.positives:,}{share}", f"{counts.negatives:,}"]

    lines = (*comparison.tasks, comparison.total, *comparison.earlier, comparison.executed)
    header = ["rows", "ours: positive", "negative", "the paper's: positive", "negative"]
    return markdown(header, [[line.name, *shown(line.ours), *shown(line.paper)] for line in lines])


def targets_table(runs: Mapping[str, Summary]) -> str:
    """The targets of learning, and what was measured."""

    def share(name: str) -> float | None:
        return runs[name]["success_rate"] if name in runs else None

    rows = []

    def add(what: str, target: str, measured: float | None, met: bool, shown: str = "") -> None:
        if measured is not None:
            rows.append([what, target, shown or f"{percent(measured)} %", "yes" if met else "**no**"])

    first, second = (share(f"round-{number}-grasp-conditional") for number in (1, 2))
    add("grasp after round 1", "41 to 61 % (paper: 51 %)", first, first is not None and 0.41 <= first <= 0.61)
    add("grasp after round 2", ">= 80 % (paper: 88 %)", second, (second or 0) >= 0.8)
    for task in ("grasp", "push"):
        found = share(f"tae-joint-{task}-conditional")
        add(f"{task}, joint", ">= 85 %", found, (found or 0) >= 0.85)
    joint, base = share("tae-joint-grasp_push-conditional"), share("random-grasp_push-conditional")
    if joint is not None and base:
        add("grasp_push, joint", ">= 3 times random", joint, joint >= 3 * base, f"{joint / base:.1f} times")
    pair = [runs.get(f"{policy}-grasp_grasp-conditional") for policy in ("tae-joint", "random")]
    if all(pair):
        table = [[run["successes"], run["eligible"] - run["successes"]] for run in pair if run]
        p = float(fisher_exact(table, alternative="greater").pvalue)
        ours, base = (percent(run["success_rate"]) for run in pair if run)
        shown = f"{ours} against {base} %, p {'< 0.0001' if p < 1e-4 else f'= {p:.4f}'}"
        add("grasp_grasp, joint", f"above random, p < {LEVEL}", p, p < LEVEL, shown)
    return markdown(["what", "target", "measured", "met"], rows)


def networks_table(plan: RecursionPlan) -> str:
    """What every network was trained on, and its validation metrics."""
    rows = []
    for entry in plan.rounds:
        for network in entry.networks:
            place = ROOT / "releases" / "checkpoints" / plan.name / network.folder / network.name
            if not place.with_suffix(".json").is_file():
                continue
            _, about = load_checkpoint(place)
            skills = ", ".join(f"{name} {skill['auc']:.3f}" for name, skill in about.metrics["skills"].items())
            config = about.training
            rows.append(
                [
                    f"{network.folder}/{network.name}",
                    about.release,
                    f"{config['updates']:,} x {config['batch_size']}",
                    f"{about.updates:,}",
                    skills,
                    f"{100 * about.metrics['balanced_accuracy']:.1f} %",
                    f"{about.metrics['calibration_error']:.3f}",
                ]
            )
    header = [
        "network",
        "data",
        "updates x batch",
        "best after",
        "validation AUC",
        "balanced accuracy",
        "calibration error",
    ]
    return markdown(header, rows)


def costs_table(plan: RecursionPlan) -> str:
    """What every stage took."""
    path = ROOT / "releases" / "checkpoints" / plan.name / "stages.json"
    costs = json.loads(path.read_text()) if path.is_file() else {}
    rows = [[str(cost["round"]), what, f"{cost['seconds'] / 60:.1f}"] for what, cost in costs.items()]
    if rows:
        rows.append(["", "total", f"{sum(cost['seconds'] for cost in costs.values()) / 60:.1f}"])
    return markdown(["round", "stage", "minutes, two cores"], rows)


def projection_table(plan: RecursionPlan, larger: RecursionPlan) -> str:
    """What another plan would take, by the cost of an episode or an update of the same stage here."""
    path = ROOT / "releases" / "checkpoints" / plan.name / "stages.json"
    costs = json.loads(path.read_text()) if path.is_file() else {}
    rows, total = [], 0.0
    for entry in larger.rounds:
        known = plan.rounds[entry.number - 1]
        stages = [(f"collect {known.release}", _episodes(known), _episodes(entry), f"collect {entry.release}")]
        updates = {f"{one.folder}/{one.name}": one.config.updates for one in known.networks}
        for one in entry.networks:
            name = f"{one.folder}/{one.name}"
            stages.append((f"train {name}", updates.get(name, 0), one.config.updates, f"train {name}"))
        for stage, here, there, title in stages:
            if stage in costs and here and there:
                minutes = costs[stage]["seconds"] / 60 * there / here
                total += minutes
                rows.append([str(entry.number), title, f"{there:,}", f"{minutes:.0f}"])
    if rows:
        rows.append(["", "total", "", f"{total:.0f}"])
    return markdown(["round", "stage", "episodes or updates", "minutes, projected"], rows)


def _episodes(entry: Any) -> int:
    """Episodes that a round collects; 0 where it is reused."""
    if entry.collection is None:
        return 0
    return int(sum(entry.collection["episodes"].values()) * len(entry.collection["tasks"]))
