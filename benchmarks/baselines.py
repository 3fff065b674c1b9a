r"""Write docs/baselines.md and its figures from run summaries, checkpoints and releases: no number in it is typed.

    rema evaluate tae --checkpoint releases/checkpoints/rema-v0/round-1 --task grasp \
        --output runs/round-1-grasp-conditional
    python benchmarks/baselines.py --runs runs/*       # copies the runs' summaries to benchmarks/results/runs/
    python benchmarks/baselines.py                     # from the copied summaries

A run of the networks of a round is told by its folder's name: ``round-N-TASK-PROTOCOL``. What has not been run yet
stays out of the tables.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from baselines.rounds.recursion_plan import RecursionPlan, load_recursion
from baselines.tae.checkpoint import load_checkpoint
from baselines.train.data import open_data
from baselines.train.pictures import draw_maps
from benchmarks.results import RESULTS, ROOT
from rema_data.loader.release import load
from rema_data.release.folder import find_release
from rema_data.schema import TASKS
from rema_data.statistics.count import count
from rema_data.statistics.plot import plot_rounds

PAGE = ROOT / "docs" / "baselines.md"
PUBLISHED = json.loads((ROOT / "manifests" / "published" / "table2.json").read_text())["success_percent"]
PAPER_BY_ROUND = {1: 51.0, 2: 88.0}
"""Grasp, percent: the only rates after a round that the paper's text names (section 4.4)."""
POLICIES = ("random", "scripted", "tae-separate", "tae-joint")
TITLE = """# The learned baselines

Made by `python benchmarks/baselines.py` from run files, checkpoints and releases; the commands of every number stand
below. What each network is, and how it is trained: [the network and its training](network.md). The paper's rates stand
beside ours for reference only: its scenes and its simulator are not ours.
"""

Summary = Mapping[str, Any]


def summaries() -> dict[str, Summary]:
    """Kept summaries of runs by the name of their folder."""
    return {path.stem: json.loads(path.read_text()) for path in sorted((RESULTS / "runs").glob("*.json"))}


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
            paper = PUBLISHED.get(policy.removeprefix("tae-"), {})
            if protocol == "conditional":
                rows.append(["*the paper's*", *(f"*{paper[task]:.1f}*" if task in paper else "" for task in tasks)])
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


def draw_rounds(found: Mapping[str, Mapping[int, Summary]], plan: RecursionPlan, path: Path) -> None:
    """The success rates by round, ours as lines, the paper's as crosses."""
    figure = Figure(figsize=(6.4, 3.8), dpi=150, facecolor="white", layout="constrained")
    axes = figure.subplots()
    for number, (task, own) in enumerate(found.items()):
        colour = f"C{number}"
        rates = [100 * run["success_rate"] for run in own.values()]
        errors = [[100 * abs(run["success_rate"] - run["ci95"][side]) for run in own.values()] for side in (0, 1)]
        axes.errorbar(list(own), rates, errors, marker="o", markersize=4, capsize=2, color=colour, label=task)
        paper = {0: PUBLISHED["random"].get(task), len(plan.rounds): PUBLISHED["joint"].get(task)}
        paper |= PAPER_BY_ROUND if task == "grasp" else {}
        known = {place: value for place, value in paper.items() if value is not None}
        axes.plot(list(known), list(known.values()), "x", color=colour, markersize=7, alpha=0.7)
    axes.plot([], [], "x", color="black", label="the paper's")
    axes.set_xticks(range(len(plan.rounds) + 1))
    axes.set_xlabel("trained on the data up to round (0: random policy)")
    axes.set_ylabel("success, % of test scenarios")
    axes.set_ylim(0, 104)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8)
    FigureCanvasAgg(figure).print_png(str(path))


def rounds_table(found: Mapping[str, Mapping[int, Summary]]) -> str:
    """Rates by round, one row a task."""
    rows = []
    for task, own in found.items():
        for number, run in own.items():
            paper = PAPER_BY_ROUND.get(number) if task == "grasp" else None
            shown = "" if paper is None else f"{paper:.0f}"
            rows.append([task, str(number), f"{run['successes']:,} / {run['eligible']:,}", rate(run), shown])
    return markdown(["task", "after round", "k / n", "ours, % [95 %]", "paper, %"], rows)


def networks_table(plan: RecursionPlan) -> str:
    """What every network was trained on, and what validation said."""
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
        rows.append(["", "all of these", f"{sum(cost['seconds'] for cost in costs.values()) / 60:.1f}"])
    return markdown(["round", "stage", "minutes, two cores"], rows)


def draw_sheet(plan: RecursionPlan, path: Path) -> None:
    """Maps of the network after round 2, over steps of the validation split of its data."""
    entry = plan.rounds[1]
    (planned,) = entry.networks
    network, _ = load_checkpoint(ROOT / "releases" / "checkpoints" / plan.name / planned.folder / planned.name)
    data = open_data(load(ROOT / "releases" / entry.release), planned.config)
    draw_maps(network, data.validation, path)


def page(plan: RecursionPlan, images: Path) -> str:
    """The whole page; draws its figures."""
    images.mkdir(exist_ok=True)
    runs = summaries()
    found = by_round(runs, plan)
    draw_rounds(found, plan, images / "success_by_round.png")
    newest = next(
        entry.release
        for entry in reversed(plan.rounds)
        if (ROOT / "releases" / entry.release / "manifest.json").is_file()
    )
    release = find_release(ROOT / "releases" / newest)
    plot_rounds(count(release), images / "data_by_round.png")
    counts = release.manifest.counts
    parts = [
        TITLE,
        "## Success by round",
        "![Success rates by round](images/success_by_round.png)",
        rounds_table(found),
        "The networks of a round are trained on the data up to it, and scored on the frozen test scenarios "
        "(conditional protocol): `rema evaluate tae --checkpoint releases/checkpoints/rema-v0/round-N --task TASK "
        "--output runs/round-N-TASK-conditional`; after the last round `rema evaluate tae-joint --task TASK`.",
        "## All policies, conditional protocol, %",
        rates_table(runs, "conditional"),
        "`rema evaluate POLICY --task TASK`: 10,000 scenarios, Wilson 95 % intervals.",
        "## End to end, %",
        rates_table(runs, "end-to-end"),
        funnel_table(runs),
        "`rema evaluate POLICY --task TASK --protocol end-to-end`: every step by the policy itself.",
        "## The networks",
        networks_table(plan),
        f"Made by `rema rounds {plan.path.relative_to(ROOT)}`. "
        "Measured at the recorded actions of the validation split.",
        "![Predicted maps over scenes](images/tae_maps.png)",
        "The network after round 2 on steps of the validation split: the score of the best angle at every place, the "
        "best action (blue), and the recorded one (green: it succeeded, red: it failed). `rema train --pictures FILE` "
        "draws such a sheet; this one: `python benchmarks/baselines.py --maps`.",
        "## The data by round",
        "![Data by round](images/data_by_round.png)",
        f"`rema stats releases/{newest} --plot docs/images/data_by_round.png`: {newest} has "
        f"{counts['episodes']:,} episodes and {counts['steps']:,} steps.",
        "## What the recursion costs",
        costs_table(plan),
        "Noted by `rema rounds` on the machine that did it; a stage that was interrupted counts its last run only. "
        "Other work ran on the same two cores meanwhile, so these minutes are too high.",
    ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def main() -> None:
    """Keep the summaries of runs, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", nargs="*", type=Path, default=[])
    parser.add_argument("--plan", type=Path, default=ROOT / "manifests" / "plans" / "rema-v0.toml")
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--maps", action="store_true", help="also draw the predicted maps anew")
    arguments = parser.parse_args()
    kept = RESULTS / "runs"
    for run in arguments.runs:
        shutil.copyfile(run / "summary.json", kept / f"{run.name}.json")
    if arguments.maps:
        draw_sheet(load_recursion(arguments.plan.resolve()), arguments.page.parent / "images" / "tae_maps.png")
    made = page(load_recursion(arguments.plan.resolve()), arguments.page.parent / "images")
    arguments.page.write_text(made, encoding="utf-8")
    print(arguments.page)


if __name__ == "__main__":
    main()
