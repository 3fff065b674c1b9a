"""The privileged reference picks: tools as they come into the hands of the frozen scenarios.

A reference pick knows where the object is, takes a bar near its middle with the jaws across it, and is an ordinary
grasp on the action grid, carried out by the simulator: what it leaves in the hand is what a good policy would get. A
learned picker replaces it in a later version of the scenario lists.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from evaluator.sim.footprints import finger_footprint
from evaluator.sim.parameters import WorldParameters
from evaluator.sim.planar import Rect, gap
from evaluator.sim.reach import valid_actions
from evaluator.sim.shapes import boxes, footprint
from evaluator.sim.simulator import Simulator
from evaluator.sim.spawn import draw_episode, draw_step
from rema_data import grid
from rema_data.schema import TASKS, Embodiment, Grip, Pinch, Placement, Situation

NEAR_MIDDLE = 0.10
"""A pick aims within this share of a bar's length from the bar's middle, where the object's shape leaves room."""
CLEARANCE_M = 0.0015
"""Room that the descending fingers must have beside the object."""
TRIES = 6


@dataclass(frozen=True, slots=True)
class Prepared:
    """An episode up to its last step: its objects, the tools in hand, and how many objects had to be drawn again."""

    placements: tuple[Placement, ...]
    grips: tuple[Grip, ...]
    pinch: Pinch | None
    redrawn: int

    def last_situation(self, task: str) -> Situation:
        """What the last step of ``task`` starts from."""
        return Situation(task, len(self.placements) - 1, self.placements[-1], self.grips, self.pinch)


def prepare(simulator: Simulator, task: str, rng: np.random.Generator) -> Prepared:
    """Draw an episode and put its tools into the hands; an object that cannot be picked or pinched is drawn again.

    Parameters
    ----------
    simulator : Simulator
    task : str
    rng : numpy.random.Generator
        Keyed by the episode.
    """
    placements = list(draw_episode(rng, task, simulator.parameters))
    redrawn = 0
    grips: list[Grip] = []
    for step in tool_steps(task):
        while (grip := reference_pick(simulator, task, step, placements[step], rng)) is None:
            placements[step] = draw_step(rng, task, step, simulator.parameters)
            redrawn += 1
        grips.append(grip)
    pinch: Pinch | None = None
    if TASKS[task][-1].embodiment is Embodiment.PINCHED:
        step = len(placements) - 2
        while (pinch := reference_pinch(simulator, placements[step], tuple(grips), rng)) is None:
            placements[step] = draw_step(rng, task, step, simulator.parameters)
            redrawn += 1
    return Prepared(tuple(placements), tuple(grips), pinch, redrawn)


def reference_pick(
    simulator: Simulator, task: str, step: int, placement: Placement, rng: np.random.Generator
) -> Grip | None:
    """Pick up an object that is to become a tool; None if no try succeeds.

    Parameters
    ----------
    simulator : Simulator
    task, step : str, int
        A picking step that is not its task's last.
    placement : Placement
    rng : numpy.random.Generator
        Chooses where along the bar, and which way round.
    """
    situation = Situation(task, step, placement)
    for tried, action in enumerate(pick_candidates(placement, rng, simulator.parameters)):
        if tried == TRIES:
            return None
        outcome = simulator.run(situation, action)
        if outcome.success:
            return outcome.grip
    return None


def pick_candidates(placement: Placement, rng: np.random.Generator, parameters: WorldParameters) -> Iterator[int]:
    """Grid actions that take a bar across, near its middle first, with room for the open fingers on both sides."""
    aims: list[tuple[float, float, float, float]] = []
    for bar in boxes(placement.spec):
        placed = bar.moved(placement.x_m, placement.y_m, placement.yaw_rad)
        along = bar.half_x >= bar.half_y
        half, axis = (bar.half_x, placed.yaw) if along else (bar.half_y, placed.yaw + math.pi / 2)
        for offset in np.linspace(-0.35, 0.35, 15) + rng.uniform(-0.02, 0.02, 15):
            aims.append((abs(float(offset)) + (0.0 if along else 0.3), float(offset) * 2 * half, axis, 0.0))
            aims[-1] = (
                aims[-1][0],
                placed.x + aims[-1][1] * math.cos(axis),
                placed.y + aims[-1][1] * math.sin(axis),
                axis,
            )
    near = [aim for aim in aims if aim[0] <= NEAR_MIDDLE]
    rng.shuffle(near)  # type: ignore[arg-type]
    rest = sorted(aim for aim in aims if aim[0] > NEAR_MIDDLE)
    flip = math.pi * int(rng.integers(2))
    fingers = finger_footprint(parameters.opening_max_m, parameters)
    target = footprint(placement)
    valid = valid_actions("grasp", 0).reshape(-1)
    for _, x, y, axis in (*near, *rest):
        action = int(grid.snap(x, y, (axis + math.pi / 2 + flip) % (2 * math.pi)))
        px, py, yaw = (float(value) for value in grid.to_world(action))
        if valid[action] and gap((rect.moved(px, py, yaw) for rect in fingers), target) > CLEARANCE_M:
            yield action


def reference_pinch(
    simulator: Simulator, placement: Placement, grips: tuple[Grip, ...], rng: np.random.Generator
) -> Pinch | None:
    """Pinch an object between two sticks, across its main bar, as a tool squared; None if no try succeeds."""
    situation = Situation("grasp_grasp_push", 2, placement, grips)
    for action in pinch_candidates(placement, rng):
        outcome = simulator.run(situation, action)
        if outcome.success:
            return outcome.pinch
    return None


def pinch_candidates(placement: Placement, rng: np.random.Generator) -> list[int]:
    """Grid actions that pinch a bar across near the centre of mass: at most three, the best aligned first."""
    valid = valid_actions("grasp_grasp_push", 2).reshape(-1)
    bars = boxes(placement.spec)
    ranked: list[tuple[float, int]] = []
    for bar in bars:
        placed: Rect = bar.moved(placement.x_m, placement.y_m, placement.yaw_rad)
        for across in (0.0, math.pi / 2):
            theta = (placed.yaw + across) % math.pi
            k = round(theta / (2 * math.pi / grid.ANGLES)) % grid.PAIR_ANGLES
            thickness = placed.half_x if across == 0.0 else placed.half_y
            error = abs((theta - k * 2 * math.pi / grid.ANGLES + math.pi / 2) % math.pi - math.pi / 2)
            # aim at the point of the bar nearest to the centre of mass
            c, s = math.cos(placed.yaw), math.sin(placed.yaw)
            dx, dy = placement.x_m - placed.x, placement.y_m - placed.y
            along = max(-placed.half_x, min(placed.half_x, c * dx + s * dy))
            side = max(-placed.half_y, min(placed.half_y, c * dy - s * dx))
            along, side = (along, 0.0) if across else (0.0, side)
            x, y = placed.x + c * along - s * side, placed.y + s * along + c * side
            action = int(grid.snap(x, y, k * 2 * math.pi / grid.ANGLES))
            if valid[action] and thickness < 0.035:
                ranked.append((error + 10 * thickness + 5 * math.hypot(x - placement.x_m, y - placement.y_m), action))
    ranked.sort()
    return [action for _, action in ranked[:2]]


def tool_steps(task: str) -> tuple[int, ...]:
    """Steps of a task whose object becomes a tool in one hand."""
    last = len(TASKS[task]) - 1
    return tuple(n for n, kind in enumerate(TASKS[task]) if n < last and not kind.embodiment.two_arms)
