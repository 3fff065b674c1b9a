"""What a step did, in words: failure labels, what may touch the target, and what was measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from evaluator.render.colours import COLOUR_NAMES
from evaluator.sim.kinds import KINDS
from evaluator.sim.parameters import WORLD
from rema_data.schema import Failure, StepKind

__all__ = ["FAILURES", "measured_text", "touching_text"]

FAILURES: dict[str, str] = {
    Failure.MISSED: "nothing that may touch the target touched it",
    Failure.BLOCKED: "the descent landed on the target: protective stop",
    Failure.NOT_LIFTED: "touched, but never carried",
    Failure.SLIPPED: "left the table and was lost before the end",
    Failure.ILLEGAL_CONTACT: "touched by something that must not touch it",
    Failure.TOO_LITTLE: f"pushed less than {WORLD.push_success_m * 100:.0f} cm in +x",
    Failure.TOOL_LOST: "a tool left the hand",
    Failure.UNREACHABLE: "outside the arms' joint limits",
    Failure.UNSTABLE: "the physics left its range of validity",
    Failure.POLICY_ERROR: "the policy raised, took too long, or gave an answer that is not an action",
}
"""What a failure label means."""


def touching_text(step: StepKind) -> str:
    """What may touch the target in a kind of step, with its colour in the pictures."""
    kind = KINDS[step]
    return kind.touching if kind.role is None else f"{kind.touching} ({COLOUR_NAMES[kind.role]})"


def measured_text(step: StepKind, measured: Mapping[str, Any]) -> str:
    """What a step of a kind measured, from the fields of its ``Evidence``."""
    if not measured["sim_steps"]:
        return "not simulated: nothing could touch the target, or no arm could move there"
    moved_cm = round((measured["displacement_m"] or 0) * 100, 1) + 0.0  # no minus before a zero
    lifted_cm, force_n = (measured["lift_m"] or 0) * 100, measured["peak_force_n"] or 0
    pushed = KINDS[step].measure == "displacement_m"
    main = f"moved {moved_cm:+.1f} cm in x" if pushed else f"lifted {lifted_cm:.1f} cm"
    force = f", {force_n:.0f} N at most in the descent" if force_n >= 0.5 else ""
    return f"{main}{force}, {measured['sim_steps']} simulation steps"
