"""Which simulator produced a result: PyBullet build, constants, and a hash of what it does to a probe."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from evaluator.sim.bullet import bullet_version
from evaluator.sim.parameters import WORLD, parameters_hash
from evaluator.sim.simulator import Simulator
from rema_data import grid
from rema_data.schema import Grip, ObjectSpec, Placement, Shape, Situation, StepOutcome, to_dict


def fingerprint() -> dict[str, str]:
    """Fingerprint of this machine's simulator, in a fraction of a second.

    ``pybullet``: the build of Bullet; ``parameters``: sha256 of every constant; ``probe``: sha256 of every bit of the
    outcomes of fixed attempts. Results are comparable bit for bit only where the last two agree.
    """
    simulator = Simulator()
    try:
        outcomes = [_probed(simulator.run(situation, action)) for situation, action in _probes()]
    finally:
        simulator.close()
    text = json.dumps(outcomes, sort_keys=True)
    return {
        "pybullet": bullet_version() or "unknown",
        "parameters": parameters_hash(),
        "probe": hashlib.sha256(text.encode()).hexdigest(),
    }


_PROBED = "success failure arm displacement_m lift_m peak_force_n contact_steps illegal_steps sim_steps grip pinch"
"""Fields that a probe's hash covers: a field that outcomes gain later must not change the fingerprint."""


def _probed(outcome: StepOutcome) -> dict[str, Any]:
    content = to_dict(outcome)
    return {name: content[name] for name in _PROBED.split()}


def _probes() -> list[tuple[Situation, int]]:
    height = WORLD.object_height_m
    bar = ObjectSpec(Shape.I, 0.10, 0.03, 0.0, height)
    tee = ObjectSpec(Shape.T, 0.11, 0.03, 0.10, height)
    stick = ObjectSpec(Shape.I, 0.18, 0.025, 0.0, height)
    tool = Grip(bar, 0.0, 0.004, height / 2 - WORLD.grasp_height_m, 1.55, bar.width_m)
    held = Grip(stick, 0.0, 0.006, height / 2 - WORLD.grasp_height_m, 1.57, stick.width_m)
    return [
        (Situation("grasp", 0, Placement(bar, 0.02, -0.03, 0.1)), int(grid.snap(0.02, -0.03, 1.6))),
        (Situation("push", 0, Placement(tee, 0.05, 0.01, 2.0)), int(grid.snap(-0.06, 0.02, 0.4))),
        (Situation("grasp_push", 1, Placement(tee, 0.05, 0.01, 4.0), (tool,)), int(grid.snap(-0.08, 0.0, 1.6))),
        (Situation("grasp_grasp", 2, Placement(bar, 0.01, 0.02, 0.7), (held, held)), int(grid.snap(0.01, 0.02, 2.3))),
    ]
