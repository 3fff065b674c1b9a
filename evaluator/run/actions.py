"""``actions.bin``: the actions of the policy, two bytes a step: enough to simulate the whole run again.

The file holds little-endian uint16 only, one row an episode and one column for every step that the policy acts in, in
the order of the scenarios: ``numpy.fromfile(path, "<u2").reshape(episodes, -1)``. A value is a grid index, or one of
two that no action can have, because their pixel lies in the corner of the map that may not be acted on.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from evaluator.run.records import Answered, Records
from rema_data import grid
from rema_data.schema import Failure

__all__ = ["NOT_ASKED", "POLICY_ERROR", "actions_of", "decode_actions", "encode_actions", "recorded_actions"]

POLICY_ERROR = grid.ACTIONS - 1
"""65,535: the policy was asked and gave no valid action."""
NOT_ASKED = grid.ACTIONS - 2
"""65,534: the episode did not get to this step, or the run was stopped before."""
_TYPE = np.dtype("<u2")

Actions = npt.NDArray[np.uint16]


def actions_of(table: pa.Table, steps: Sequence[int]) -> Actions:
    """Actions in a table of episodes, uint16 (episodes, steps)."""
    found = np.full((table.num_rows, len(steps)), NOT_ASKED, np.uint16)
    for column, step in enumerate(steps):
        actions = table.column(f"step{step}_action").to_pylist()
        failures = table.column(f"step{step}_failure").to_pylist()
        for row, (action, failure) in enumerate(zip(actions, failures, strict=True)):
            if action is not None:
                found[row, column] = action
            elif failure == Failure.POLICY_ERROR.value:
                found[row, column] = POLICY_ERROR
    return found


def encode_actions(actions: Actions) -> bytes:
    """Content of ``actions.bin``."""
    return actions.astype(_TYPE).tobytes()


def decode_actions(payload: bytes, episodes: int, steps: int) -> Actions | None:
    """Inverse of ``encode_actions``, uint16 (episodes, steps); None where the length is another one."""
    if len(payload) != episodes * steps * _TYPE.itemsize:
        return None
    return np.frombuffer(payload, _TYPE).reshape(episodes, steps).astype(np.uint16)


def recorded_actions(actions: Actions, steps: Sequence[int]) -> Records:
    """Records that hold these answers and no outcome."""
    records = Records()
    records.add_answers(
        Answered(index, step, None if action == POLICY_ERROR else action)
        for index, row in enumerate(actions.tolist())
        for step, action in zip(steps, row, strict=True)
        if action != NOT_ASKED
    )
    return records
