"""Write docs/suite.md and its pictures: the cells of the generalisation suite, as the code defines them.

python benchmarks/suite_page.py            # the page
python benchmarks/suite_page.py --pictures # and a picture of every cell, drawn from validation scenarios
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.baseline_tables import markdown
from benchmarks.results import ROOT
from evaluator.scenarios import load_list, manifest_path
from evaluator.scenarios.axes import AXES, Axis
from evaluator.scenarios.lists import installed_list
from evaluator.scenarios.suite import CELL, TRIES, vary
from evaluator.scenarios.suites import cells
from evaluator.scenarios.varied import CLEAN
from evaluator.sim.observation import observe
from evaluator.sim.simulator import Simulator
from rema_data.grid import EE_HALF_M, SCENE_HALF_M
from rema_data.schema import TASKS

NAME = "hard-v1"
PAGE = ROOT / "docs" / "suite.md"
PICTURES = ROOT / "docs" / "images"
_TEXT = """# The generalisation suite

Made by `python benchmarks/suite_page.py`.

Two of the clean tasks no longer tell good policies apart. A suite plays the same last steps with one thing changed:
what stands on the table, what is in the hand, what the maps show, where the hand goes, or how the objects behave. A
policy sees none of this but by its maps.

```sh
rema evaluate my_policy.py --task grasp --suite hard-v1          # all cells, in one shuffled stream
rema leaderboard --suite hard-v1                                 # by axis
rema compare runs/a-grasp-hard-v1 runs/b-grasp-hard-v1           # by cell
```

{frozen}

A **cell** is one task, one axis and one level. Its scenarios are made of clean ones with the same index: {test} of the
test list, {val} of the validation list. Every axis has indices of its own, which its levels share, so cells are paired
with each other and with a clean run. All cells of a task are one list, in an order that says nothing about them.
Everything is frozen in the list: objects, seeds of the noise, displacements. An observation and an outcome are pure
functions of a scenario and an action, as in the clean protocol, whose lists, constants and results a suite does not
touch.

Every scenario also has the sha256 of its maps. A run compares them before it asks the policy: a machine that works the
noise out differently ends it with exit code 6, at the first observations.

A scenario without noise or displacement can be solved: one of {tries} actions, those of the reference policy first,
solves it. One that cannot is drawn again, so the ceiling of such a cell is 100 %.

{redrawn}

## The axes

{axes}

*in `hard`*: whether the axis counts in the mean. `posts` is a track of its own, since a policy has to be told that
targets are 30 mm high and posts, which are not to be touched, 60 mm. `mixed` is reported apart.

What cannot be solved is left out: two sticks hold few slippery, heavy or unbalanced objects, so `physics` is for one
hand, and lift few targets wider than 50 mm, so `size` has two levels less in grasp_grasp. Tools are held where the
reference policy picks them; no axis moves the grip.

{pictures}

## The score

An axis is the mean of its levels, `hard` the mean of its axes. If a scenario has no result, no mean is
shown. Policies are ranked by `hard` itself; beside it stand the clean rate, the share of it that is
kept, and the worst axis. Ranking by the kept share would reward weak policies. Intervals are those of a bootstrap over
clean scenarios (10,000 times), since levels share them; at 0 and 100 % they are exact ones (Clopper-Pearson) over clean
scenarios. Two policies share a letter where their difference, over the
same draws, is not significant after Holm's adjustment for all pairs of the suite.

Policies are ranked in two groups. A *clean-trained* policy never saw a changed situation before; an *adapted* one was
trained on some, of the training seeds, and says so ([how](submit.md#4-make-the-entry)). What the two measure is not the
same: whether skill carries over, and how much of the change can be learned. Each group has its own table, letters and
ranks.

Where other loose objects lie beside the target (`clutter`), lifting any one of them, alone, counts: the one between the
fingers is the target of the attempt.

## Training data with the same changes

A round of a collection plan may vary its episodes by the same axes:

```toml
[[rounds]]
policy = "random"
picks = "reference"
episodes = {{ train = 2000, val = 200 }}
tasks = ["grasp", "grasp_push"]
vary = ["clutter", "tool", "sense"]     # or vary = {{ axes = ["clutter", "tool", "sense"], clean = 0.1 }}
```

Of the episodes, {clean:.0%} are clean, or the share that the plan says. Each of the others has one axis, of those that
its task has, at one of its levels; axes, and levels of an axis, are drawn equally often, from the generator of the
episode. Scenes are those of the collection, so none is one of a suite. Whether an episode can be solved is not checked,
and tools are picked by the policy of the first steps. Clean episodes keep every byte: a plan without `vary` makes the
release that it always made. [dataset.md](dataset.md#varied-episodes) says how a release records what is varied.

`rema rounds manifests/plans/rema-v1-hard.toml` continues rema-v1 with 22,000 such episodes, and trains the networks
`robust/grasp` and `robust/push` on both. A policy that has learned from varied scenes is an adapted one: say so where
you report it, and compare it with others of its kind. Neither this release nor its networks come with rema.
"""


def frozen_text() -> str:
    """Which lists of the suite are frozen."""
    there = [task for task in TASKS if installed_list(task, "test", NAME) and installed_list(task, "val", NAME)]
    missing = [task for task in TASKS if task not in there]
    text = f"The suite `{NAME}` is frozen in {', '.join(there) or 'no task yet'}."
    if missing:
        text += (
            f" Its lists in {', '.join(missing)} are still to come; until then, draw some of your own: "
            "`rema scenarios my-suite --suite --cell 50 20`."
        )
    return text


def redrawn_table() -> str:
    """How many scenarios every frozen list has, and how often one could not be solved and was drawn again."""
    path = manifest_path(NAME)
    lists = json.loads(path.read_bytes())["lists"] if path.is_file() else {}
    rows = []
    for name, entry in lists.items():
        again = [f"{cell}: {count}" for cell, count in entry["redrawn_by_cell"].items() if count]
        cells = len(entry["redrawn_by_cell"])
        rows.append([name, str(cells), f"{entry['count']:,}", str(entry["redrawn"]), ", ".join(again) or "none"])
    return markdown(["list", "cells", "scenarios", "drawn again", "in the cells"], rows)


def axes_table() -> str:
    """Every axis: what changes, its levels, the tasks that have it."""
    rows = [
        [
            f"`{axis.name}`",
            axis.title,
            "; ".join(f"{number}: {level}{without(axis, number)}" for number, level in enumerate(axis.levels, 1)),
            "all" if set(axis.tasks) == set(TASKS) else ", ".join(axis.tasks),
            "yes" if axis.counts else "no",
        ]
        for axis in AXES.values()
    ]
    return markdown(["axis", "what changes", "levels", "tasks", "in `hard`"], rows)


def without(axis: Axis, level: int) -> str:
    """In which tasks a level is left out."""
    tasks = [task for task, levels in axis.left_out.items() if level in levels]
    return f" (not in {', '.join(tasks)})" if tasks else ""


def draw(task: str, path: Path) -> None:
    """A row an axis, a column a level: the scene, and below it the end effector, of one validation scenario."""
    found = cells(task)
    names = list(dict.fromkeys(cell.axis for cell in found))
    most = max(cell.level for cell in found)
    figure = Figure(
        figsize=(1.5 * (2 * most + 0.6), 1.6 * len(names)), dpi=110, facecolor="white", layout="constrained"
    )
    grid: np.ndarray[tuple[int, int], np.dtype[np.object_]] = figure.subplots(len(names), 2 * most, squeeze=False)
    for one in grid.flat:
        one.set_axis_off()
    simulator, clean = Simulator(), load_list(task, "val").scenarios
    for cell in found:
        axis = AXES[cell.axis]
        scenario = vary(simulator, clean[CELL["val"] * axis.number + 3], cell).scenario
        seen = observe(scenario.last_situation())
        row, column = names.index(cell.axis), 2 * (cell.level - 1)
        _show(grid[row, column], seen.scene, SCENE_HALF_M, f"{cell.axis} {cell.level}")
        _show(grid[row, column + 1], seen.depth[0], EE_HALF_M, "")
    FigureCanvasAgg(figure).print_png(str(path))


def _show(axes: Axes, heights: np.ndarray, half_m: float, title: str) -> None:
    axes.imshow(heights / 10, origin="lower", cmap="magma", vmin=0, vmax=60, extent=(-half_m, half_m) * 2)
    axes.set_title(title, fontsize=7, pad=2, loc="left")


def main() -> None:
    """Write the page, and its pictures if they are asked for."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--pictures", action="store_true")
    arguments = options.parse_args()
    shown = []
    for task in TASKS:
        path = PICTURES / f"suite_{task}.png"
        if arguments.pictures:
            draw(task, path)
        shown.append(
            f"![Cells of {task}](images/{path.name})\n\nScene and end-effector map of one validation scenario of every "
            f"cell of {task}, heights in mm from black (0) to white (60)."
        )
    text = _TEXT.format(
        **CELL,
        tries=TRIES,
        clean=CLEAN,
        frozen=frozen_text(),
        redrawn=redrawn_table(),
        axes=axes_table(),
        pictures="\n\n".join(shown),
    )
    PAGE.write_text(text, encoding="utf-8")
    print(PAGE)


if __name__ == "__main__":
    main()
