"""Fixed posts that nothing may touch: a track of its own."""

from __future__ import annotations

import math

from evaluator.scenarios.axes.base import Axis, Draw, varied
from evaluator.scenarios.axes.clutter import beside
from evaluator.sim.planar import gap, swept
from evaluator.sim.shapes import footprint
from rema_data.grid import SCENE_HALF_M
from rema_data.schema import ObjectSpec, Placement, Primitive, Scenario, Shape

__all__ = ["Posts"]

_SIDE_M, _HEIGHT_M = 0.03, 0.06
_GAP_M = (0.010, 0.045)
_SEEN_M = SCENE_HALF_M - _SIDE_M
"""Farthest place of a post from the middle, along an axis: all of it is on the map."""
_TRIES = 400


class Posts(Axis):
    """Posts beside the target. Targets are 30 mm high, posts 60 mm: that is how a policy tells them apart."""

    name, number = "posts", 11
    title = "fixed posts, 30 x 30 x 60 mm, 10 to 45 mm from the target; nothing may touch them"
    levels = ("1 post", "2 posts", "3 posts")
    tasks = ("grasp", "push", "grasp_push")
    counts = False

    def vary(self, scenario: Scenario, level: int, draw: Draw) -> Scenario | None:
        target = scenario.placements[-1]
        push = scenario.last_situation().kind.primitive is Primitive.PUSH
        lanes = [swept(rect, 0.35 if push else 0.0) for rect in footprint(target)]
        posts: list[Placement] = []
        for _ in range(_TRIES):
            towards, far = (float(value) for value in draw.rng.uniform((0.0, 0.03), (2 * math.pi, 0.16)))
            place = target.x_m + far * math.cos(towards), target.y_m + far * math.sin(towards)
            spec = ObjectSpec(Shape.I, _SIDE_M, _SIDE_M, 0.0, _HEIGHT_M)
            post = Placement(spec, *place, float(draw.rng.uniform(0, 2 * math.pi)))
            apart = gap(footprint(post), footprint(target))
            lane_free = not push or gap(footprint(post), lanes) > _GAP_M[0]  # a push keeps a free lane
            if max(map(abs, place)) > _SEEN_M:
                continue
            if _GAP_M[0] <= apart <= _GAP_M[1] and lane_free and beside(post, tuple(posts)):
                posts.append(post)
            if len(posts) == level:
                return varied(scenario, posts=tuple(posts))
        return None
