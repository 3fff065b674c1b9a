r"""Write docs/baselines.md and its figures from run summaries, checkpoints and releases: no number in it is typed.

    rema evaluate tae --checkpoint releases/checkpoints/rema-v1/round-1 --task grasp \
        --output runs/rema-v1-round-1-grasp-conditional
    python benchmarks/baselines.py --runs runs/*       # copies the runs' summaries to benchmarks/results/runs/
    python benchmarks/baselines.py                     # from the copied summaries
    python benchmarks/baselines.py --plan manifests/plans/rema-v0.toml --page FILE      # of an earlier release

The folder's name identifies a run of the networks of a plan: ``PLAN-FOLDER-TASK-PROTOCOL``, such as the one above.
Those that ship under the name of a policy need no such name while they do. Runs that do not exist yet are not in the
tables.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from baselines.rounds.recursion_plan import RecursionPlan, load_recursion
from baselines.tae.checkpoint import load_checkpoint
from baselines.train.data import open_data
from baselines.train.pictures import draw_maps
from benchmarks.baseline_tables import (
    Summary,
    by_round,
    collected_table,
    costs_table,
    funnel_table,
    networks_table,
    of_plan,
    paper_by_round,
    paper_table,
    projection_table,
    rates_table,
    rounds_table,
    targets_table,
)
from benchmarks.kept_runs import keep, kept_runs
from benchmarks.report import measured
from benchmarks.results import RESULTS, ROOT
from evaluator.policy.shipped import shipped_policies
from rema_data.loader.release import load
from rema_data.release.folder import find_release
from rema_data.statistics.count import count
from rema_data.statistics.paper import compare
from rema_data.statistics.plot import plot_rounds

PAGE = ROOT / "docs" / "baselines.md"
PLAN = ROOT / "manifests" / "plans" / "rema-v1.toml"
LARGER = PLAN
"""The plan whose cost is projected on the page of a smaller one."""
ABLATIONS = ("ablation", "ablation_cpu")
"""Results of ``ablation.py``: trained on a GPU, and on a CPU."""
LATER = {"methods": "Methods: joint against separate", "fine": "What a better policy is made of"}
"""Results about the networks of ``PLAN``, with their titles."""
TITLE = """# The learned baselines

The baselines of {plan}. Made from run files, checkpoints and releases by
`python benchmarks/baselines.py{options}`.
The command of every number is below it. [The network and its training](network.md) describes the networks. The paper's
rates are shown for reference only: its scenes and its simulator are not ours.
"""

WORLD = """
The learned policies are far above the paper's in the tasks with tools, and near 100 % in grasp and push. Our world has
no noise in observations or actions, and an outcome is a function of scene and action. So a network that is right about
an action is right about it every time. The paper does not say whether its world has noise."""

ROUND_1 = {
    "rema-v0": """
Grasp after round 1 is above the target. The main reason is the number of updates, which the paper does not state: with
fewer updates the rate falls to the paper's and below it (see "What round 1 depends on"). We tried other changes, and
most of them raise the rate further:""",
    "rema-v1": """
What grasp reaches after round 1 depends on the number of updates more than on anything else, and the paper does not
state it. rema-v0 took 3,000 and was above the target; rema-v1 takes 300, so that round 2 still meets failures to learn
from, as the paper's did. We tried other changes with rema-v0, and most of them raise the rate further:""",
}
"""What there is to say of round 1 of a plan, before what was tried."""

TRIED = """
- Finer cells of the features solve almost all of grasp with the same data. So do grasps that are not rotated in
  training, which the paper does not mention; the paper's learning rate takes back a part of that.
- One wrong label in a hundred raised the rate, in the one training that we made with it.
- Balance on average, another seed or another processor change the rate by some points, as much as trainings differ
  anyway.
- A hand that arrives up to a pixel beside its goal costs little.
- The decision rule is not the reason either. Round 2 of rema-v0 was collected with the argmax of probabilities, which
  float32 rounds to 1 for many actions of a confident network. The policy now compares log odds, and the same weights
  reach about the same rate with both rules.

The validation split hardly shows how far a training has come: its actions are random, and what matters is the best of
50,176 actions. We trained the network after round 1 of rema-v0 twice on one machine, with the same number of threads:
the weights were equal, byte for byte."""

COSTS = {
    "rema-v0": "The collection of round 1 was timed in a second run, alone: `rema rounds manifests/plans/rema-v0.toml "
    "--stages 1 --output FOLDER` gave the same episodes and maps as the release. Random grasps are fast: most of them "
    "touch nothing and need no simulation. The networks of one round were trained two at a time, each on one core, "
    "while other work ran on the same two cores. So the sum is larger than the time of all stages one after the other "
    "on an idle machine.",
    "rema-v1": "Random grasps are fast: most of them touch nothing and need no simulation. The networks of one round "
    "were trained two at a time, each on one core, and other work ran on the same two cores all the time. So the times "
    "are upper bounds, and stages do not compare with each other. The training after round 1 has no recorded time: the "
    "total leaves it out.",
}


def draw_rounds(found: Mapping[str, Mapping[int, Summary]], plan: RecursionPlan, path: Path) -> None:
    """The success rates by round, ours as lines, the paper's as crosses."""
    figure = Figure(figsize=(6.4, 3.8), dpi=150, facecolor="white", layout="constrained")
    axes = figure.subplots()
    for number, (task, own) in enumerate(found.items()):
        colour = f"C{number}"
        rates = [100 * run["success_rate"] for run in own.values()]
        errors = [[100 * abs(run["success_rate"] - run["ci95"][side]) for run in own.values()] for side in (0, 1)]
        axes.errorbar(list(own), rates, errors, marker="o", markersize=4, capsize=2, color=colour, label=task)
        known = paper_by_round(task, len(plan.rounds))
        axes.plot(list(known), list(known.values()), "x", color=colour, markersize=7, alpha=0.7)
    axes.plot([], [], "x", color="black", label="the paper's")
    axes.set_xticks(range(len(plan.rounds) + 1))
    axes.set_xlabel("trained on the data up to round (0: random policy)")
    axes.set_ylabel("success, % of test scenarios")
    axes.set_ylim(0, 104)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8)
    FigureCanvasAgg(figure).print_png(str(path))


def draw_sheet(plan: RecursionPlan, path: Path) -> None:
    """Maps of the network after round 2, over steps of the validation split of its data."""
    entry = plan.rounds[1]
    (planned,) = entry.networks
    network, _ = load_checkpoint(ROOT / "releases" / "checkpoints" / plan.name / planned.folder / planned.name)
    data = open_data(load(ROOT / "releases" / entry.release), planned.config)
    draw_maps(network, data.validation, path)


def results(*names: str) -> list[str]:
    """Tables of the result files of those names that are there."""
    found = [path for name in names if (path := RESULTS / f"{name}.json").is_file()]
    return ["\n".join(measured(json.loads(path.read_text(encoding="utf-8")))) for path in found]


def ablation() -> list[str]:
    """What the success after round 1 depends on, as far as it was measured."""
    tables = results(*ABLATIONS)
    return ["## What round 1 depends on", "Measured with round 1 of rema-v0.", *tables] if tables else []


def later(plan: RecursionPlan) -> list[str]:
    """What was measured with the networks of a plan beside their rates."""
    parts: list[str] = []
    for name, title in LATER.items():
        if plan.path.samefile(PLAN) and (tables := results(name)):
            parts += [f"## {title}", *tables]
    return parts


def page(plan: RecursionPlan, images: Path) -> str:
    """The whole page; draws its figures."""
    images.mkdir(exist_ok=True)
    runs = of_plan(kept_runs(), plan)
    found = by_round(runs, plan)
    draw_rounds(found, plan, images / "success_by_round.png")
    newest = next(
        entry.release
        for entry in reversed(plan.rounds)
        if (ROOT / "releases" / entry.release / "manifest.json").is_file()
    )
    release = find_release(ROOT / "releases" / newest)
    plot_rounds(count(release), images / "data_by_round.png")
    counts, comparison = release.manifest.counts, compare(count(release))
    where = plan.path.resolve().relative_to(ROOT)
    elsewhere = [
        f"In {task}, `{policy}` plays networks of its own, `releases/checkpoints/{own.folder}`."
        for policy, shipped in shipped_policies().items()
        for task, own in shipped.tasks.items()
        if shipped.folder.startswith(f"{plan.name}/")
    ]
    parts = [
        TITLE.format(plan=plan.name, options="" if plan.path.samefile(PLAN) else f" --plan {where}"),
        "## Targets",
        targets_table(runs),
        WORLD,
        ROUND_1.get(plan.name, "We tried other changes of round 1 with rema-v0:"),
        TRIED,
        "## Success by round",
        "![Success rates by round](images/success_by_round.png)",
        rounds_table(found, len(plan.rounds)),
        "The networks of a round are trained on the data up to this round and scored on the frozen test scenarios "
        f"(conditional protocol): `rema evaluate tae --checkpoint releases/checkpoints/{plan.name}/round-N --task TASK "
        f"--device openvino --output runs/{plan.name}-round-N-TASK-conditional`; after the last round: `rema evaluate "
        "tae-joint --task TASK --device openvino`.",
        *ablation(),
        "## All policies, conditional protocol, %",
        rates_table(runs, "conditional"),
        "`rema evaluate POLICY --task TASK --device openvino`: 10,000 scenarios, Wilson 95 % intervals.",
        *elsewhere,
        "## End to end, %",
        rates_table(runs, "end-to-end"),
        funnel_table(runs),
        "`rema evaluate POLICY --task TASK --device openvino --protocol end-to-end`: the policy plays every step.",
        *later(plan),
        "## The networks",
        networks_table(plan),
        f"Made by `rema rounds {where}`. Measured at the recorded actions of the validation split.",
        "![Predicted maps over scenes](images/tae_maps.png)",
        "The network after round 2 on steps of the validation split: the score of the best angle at every place, the "
        "best action (blue), and the recorded one (green: it succeeded, red: it failed). `rema train --pictures FILE` "
        "draws such a sheet; this one: `python benchmarks/baselines.py --maps`.",
        "## The data by round",
        "![Data by round](images/data_by_round.png)",
        f"`rema stats releases/{newest} --plot docs/images/data_by_round.png`: {newest} has "
        f"{counts['episodes']:,} episodes and {counts['steps']:,} steps. The paper's bars are from its Table 2.",
        collected_table(release),
        "Last steps, training split."
        + (" Rounds 1 to 3 were played with an earlier decision rule: see above." if plan.name == "rema-v0" else ""),
        "The whole release beside the paper's Table 2, as `rema stats --check-paper` shows it:",
        paper_table(comparison),
        "\n".join(f"- {remark}" for remark in comparison.remarks),
        "## What the recursion costs",
        costs_table(plan),
        "`rema rounds` recorded these times on the machine that made the release. For a stage that was interrupted, "
        f"only the last run counts. {COSTS.get(plan.name, '')}",
    ]
    if plan.name != LARGER.stem:
        parts += [
            f"A projection for {LARGER.relative_to(ROOT)}, from the time of an episode or an update of the same stage:",
            projection_table(plan, load_recursion(LARGER)),
        ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def main() -> None:
    """Keep the summaries of runs, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", nargs="*", type=Path, default=[])
    parser.add_argument("--plan", type=Path, default=PLAN)
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--maps", action="store_true", help="draw the predicted maps, too")
    arguments = parser.parse_args()
    keep(arguments.runs)
    if arguments.maps:
        draw_sheet(load_recursion(arguments.plan.resolve()), arguments.page.parent / "images" / "tae_maps.png")
    made = page(load_recursion(arguments.plan.resolve()), arguments.page.parent / "images")
    arguments.page.write_text(made, encoding="utf-8")
    print(arguments.page)


if __name__ == "__main__":
    main()
