"""The protocol of a run, in words and numbers, and its hash: rows of a table compare only where the hashes agree."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from evaluator.sim.kinds import KINDS
from evaluator.sim.parameters import parameters_hash
from rema_data import grid
from rema_data.errors import InputError
from rema_data.schema import TASKS, check_task

__all__ = [
    "ACTION_FLIP_LIMIT",
    "AUDIT_LEAST",
    "AUDIT_SHARE",
    "BLANKED",
    "FAULT_CHECK",
    "FAULT_LIMIT",
    "FIRST_LOOK",
    "FLIP_LIMIT",
    "FRESH_SCENARIOS",
    "INFRA_LIMIT",
    "MAX_BATCH",
    "PROTOCOLS",
    "SCENARIOS",
    "acting_steps",
    "check_protocol",
    "protocol",
    "protocol_hash",
]

FAULT_LIMIT = 0.10
"""Largest share of a policy's answers that may be faults: above it a run fails."""
FAULT_CHECK = 100
"""Answers before the share of faults is checked for the first time; it is checked again at the end."""
INFRA_LIMIT = 0.001
"""Largest share of episodes that may be lost to the infrastructure."""
ACTION_FLIP_LIMIT = 0.05
"""Largest share of the repeated questions that may be answered differently: rounding does that to a few. A policy whose
answers depend on what it was asked before, or in which order, does it to most, and has no rank."""
FLIP_LIMIT = 0.005
"""Where actions are simulated by another simulator than the run's: the largest share of other outcomes, at its 95 %
upper bound, up to which they confirm the run."""
AUDIT_SHARE, AUDIT_LEAST = 0.01, 30
"""Share of the episodes of a run that is repeated, and the smallest number of them."""
FIRST_LOOK = 100
"""Episodes of a quick run before its first test; every later test comes after twice as many."""
MAX_BATCH = 4096
"""Observations in one question to a policy: about a gigabyte."""
SCENARIOS = {"test": 10_000, "val": 2_000}
"""Scenarios of the frozen lists of a task, by split."""
FRESH_SCENARIOS = 2_000
"""Scenarios of a fresh list."""

PROTOCOLS: dict[str, str] = {
    "conditional": (
        "Only the last step is played, with the tools of the scenario in hand: every policy faces the same "
        "situations. The rate is that of the last step."
    ),
    "end-to-end": (
        "Every step is played from empty hands with the policy's own picks; an episode ends at its first failed step. "
        "The rate is that of the whole task."
    ),
}
"""Protocol names, and what they mean."""
BLANKED: dict[str, str] = {
    f"blank-{part}": (
        f"As conditional, but every policy is shown {zeros} in place of what is there. The rate is what it reaches "
        f"without seeing the {part}."
    )
    for part, zeros in (("scene", "an empty table"), ("hand", "end-effector maps of zeros"))
}
"""Protocols of self-audits, in which a part of the maps is blanked; each has its own hash, and none is a row."""


def acting_steps(task: str, protocol: str) -> tuple[int, ...]:
    """Steps in which the policy acts, which are those that are scored: the last one (conditional), or all."""
    steps = tuple(range(len(TASKS[task])))
    return steps if protocol == "end-to-end" else steps[-1:]


def check_protocol(name: str) -> str:
    """``name``; an InputError where there is no such protocol."""
    if name not in PROTOCOLS and name not in BLANKED:
        known = ", ".join((*PROTOCOLS, *BLANKED))
        raise InputError(f"unknown protocol {name!r}", hint=f"choose one of: {known}", protocol=name, field="protocol")
    return name


def protocol(task: str, name: str) -> dict[str, Any]:
    """Everything that decides what a rate of ``task`` means, ready for JSON.

    Parameters
    ----------
    task : str
    name : str
        One of ``PROTOCOLS`` and ``BLANKED``.

    Raises
    ------
    InputError
        When there is no such task or protocol.
    """
    kinds, meaning = TASKS[check_task(task)], (PROTOCOLS | BLANKED)[check_protocol(name)]
    return {
        "version": 1,
        "schema_version": 1,  # of the records that the results are made of, not of a file: it stays
        "name": name,
        "meaning": meaning,
        "task": task,
        "steps": [
            {"primitive": str(kind.primitive), "embodiment": str(kind.embodiment), "success": KINDS[kind].criterion()}
            for kind in kinds
        ],
        "scored_steps": list(acting_steps(task, name)),
        "policy_errors": "An answer that is no valid action, and no answer, are failures: always in the denominator.",
        "infrastructure_errors": "Not eligible: neither success nor failure; counted, and both bounds are printed.",
        "grid": {
            "pixel_m": grid.PIXEL_M,
            "scene_pixels": grid.SCENE_PIXELS,
            "end_effector_pixels": grid.EE_PIXELS,
            "angles": grid.ANGLES,
            "pair_angles": grid.PAIR_ANGLES,
            "valid_margin_pixels": grid.VALID_MARGIN,
        },
        "parameters_hash": parameters_hash(),
    }


def protocol_hash(task: str, name: str) -> str:
    """sha256 (hexadecimal) of the canonical JSON of ``protocol(task, name)``."""
    text = json.dumps(protocol(task, name), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
