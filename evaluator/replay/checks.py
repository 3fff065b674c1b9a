"""Checks that need no simulation: is this the same world, are the recorded actions valid ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from evaluator.run.actions import NOT_ASKED, POLICY_ERROR
from evaluator.run.check import Finding, row_name
from evaluator.run.plan import Plan
from evaluator.run.run import Run
from evaluator.run.seal import ACTIONS_FILE
from evaluator.sim.bullet import decisive
from rema_data import grid

__all__ = ["invalid_actions", "world_differences"]


def world_differences(run: Run, fingerprint: dict[str, str], protocol_hash: str) -> dict[str, tuple[Any, Any]]:
    """How the simulator and the protocol here differ from those of a run: field to (recorded, here).

    Empty where a replay must give the same bits.
    """
    known, here = decisive(run.provenance.fingerprint), decisive(fingerprint)
    pairs = {name: (known.get(name), here.get(name)) for name in sorted(known.keys() | here.keys())}
    pairs["protocol_hash"] = (run.provenance.protocol_hash, protocol_hash)
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}


def invalid_actions(
    run: Run,
    actions: npt.NDArray[np.uint16],
    plan: Plan,
    valid_actions: Callable[[str, int], npt.NDArray[np.bool_]],
) -> Iterator[Finding]:
    """Recorded actions that the protocol does not allow."""
    for column, step in enumerate(plan.steps):
        valid = valid_actions(plan.task, step).reshape(grid.ACTIONS)
        taken = actions[:, column]
        for row in np.flatnonzero(~valid[taken] & (taken != POLICY_ERROR) & (taken != NOT_ASKED)).tolist():
            where = f"{row_name(run.table, row)}, step {step}"
            yield Finding(ACTIONS_FILE, where, f"action {taken[row]} is not a valid one")
