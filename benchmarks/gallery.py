"""Draw the pictures of the README and of docs/world.md: one successful episode of each task, into docs/images.

    python benchmarks/gallery.py
    python benchmarks/gallery.py --tasks grasp,push --folder /tmp/images

Episodes are drawn from the ``calibrate`` seed domain, tools come from the reference pick, and the scripted aim acts:
its angles are tried one after the other, and the first success with a target near the middle is shown.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.situations import last_situation
from evaluator.render.film import FilmMaker
from evaluator.render.preview import write_preview
from evaluator.sim.kinds import KINDS
from evaluator.sim.reach import valid_actions
from evaluator.sim.simulator import Simulator
from evaluator.sim.spawn import episode_generator
from rema_data import grid
from rema_data.schema import TASKS, Situation

ROOT_SEED = 7
MIDDLE_M = 0.06
"""Shown targets are this near to the middle, so that the map has them whole."""
IN_VIEW_M = 0.35
"""A shown push moves its target no farther, so that it is still in the picture."""
COLOURS = 256
"""Of each file: enough for shaded bodies, and small enough for a repository."""
TITLES = {
    "grasp": "grasp: pick the object up with the gripper",
    "push": "push: move the object 10 cm with the closed gripper",
    "grasp_grasp": "grasp_grasp: lift the object between two sticks",
    "grasp_push": "grasp_push: move the object 10 cm with a tool",
    "grasp_grasp_push": "grasp_grasp_push: move the object 10 cm with an object held between two sticks",
}


def success(simulator: Simulator, task: str, first: int) -> tuple[Situation, int]:
    """The first scripted success from episode ``first`` on: its situation and action."""
    kind = TASKS[task][-1]
    valid = valid_actions(task, len(TASKS[task]) - 1).reshape(-1)
    # a pair is seen best from the side
    angles = (4, 3, 5, 2, 6) if kind.embodiment.two_arms else tuple(range(grid.ANGLES))
    for episode in range(first, first + 200):
        situation = last_situation(task, simulator, episode_generator(ROOT_SEED, "calibrate", task, episode))
        if situation is None:
            continue
        target = situation.target
        if max(abs(target.x_m), abs(target.y_m)) > MIDDLE_M:
            continue
        x_m, y_m = KINDS[kind].aim(target)
        for k in angles:
            action = int(grid.snap(x_m, y_m, k * 2 * np.pi / grid.ANGLES))
            if not valid[action]:
                continue
            outcome = simulator.run(situation, action)
            if outcome.success and outcome.displacement_m < IN_VIEW_M:
                return situation, action
    raise SystemExit(f"no success in 200 episodes of {task}")


def main() -> None:
    """Draw and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", default=",".join(TASKS))
    parser.add_argument("--folder", type=Path, default=Path(__file__).resolve().parent.parent / "docs" / "images")
    parser.add_argument("--first", type=int, default=0, help="episode to begin with")
    arguments = parser.parse_args()
    simulator = Simulator()
    for task in arguments.tasks.split(","):
        situation, action = success(simulator, task, arguments.first)
        path = arguments.folder / f"{task}.png"
        with FilmMaker() as films:
            write_preview(films.take(situation, action), path, TITLES[task], COLOURS)
        print(f"{path}: {path.stat().st_size / 1000:.0f} kB", file=sys.stderr)
    simulator.close()


if __name__ == "__main__":
    main()
