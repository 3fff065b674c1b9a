"""The action log holds every action; the two values for "no action" cannot be confused with one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from evaluator.run.actions import (
    NOT_ASKED,
    POLICY_ERROR,
    actions_of,
    decode_actions,
    encode_actions,
    recorded_actions,
)
from evaluator.run.records import Answered, Records, Simulated
from evaluator.run.tables import results_table
from evaluator.scenarios import load_list
from rema_data import grid
from rema_data.schema import Failure, StepOutcome


@pytest.mark.parametrize("value", [POLICY_ERROR, NOT_ASKED])
def test_no_action_can_have_a_special_value(value: int) -> None:
    i, j, _ = grid.decode(value)
    assert 0 <= value < grid.ACTIONS
    assert not grid.inside_valid_square()[i, j]


@given(arrays(np.uint16, st.tuples(st.integers(0, 20), st.integers(1, 4))))
def test_what_is_written_is_read(actions: np.ndarray) -> None:
    payload = encode_actions(actions)
    assert len(payload) == 2 * actions.size
    found = decode_actions(payload, *actions.shape)
    assert found is not None and np.array_equal(found, actions)
    assert decode_actions(payload + b"\0", *actions.shape) is None


def test_from_records_to_the_log_and_back(fake_home: object) -> None:
    steps = (0, 1, 2, 3)
    records = Records()
    records.add_answers([Answered(0, 0, 33_000), Answered(1, 0, None, "nan", "nan"), Answered(0, 1, 33_001)])
    records.add_outcomes(
        [
            Simulated(0, 0, StepOutcome(True, None, arm="left"), 0.1, "w0", 1),
            Simulated(0, 1, StepOutcome(False, Failure.MISSED, arm="left"), 0.1, "w0", 1),
        ]
    )
    log = actions_of(results_table(load_list("grasp_grasp_push"), 3, steps, records), steps)
    assert log.tolist() == [
        [33_000, 33_001, NOT_ASKED, NOT_ASKED],
        [POLICY_ERROR, NOT_ASKED, NOT_ASKED, NOT_ASKED],
        [NOT_ASKED] * 4,
    ]
    again = recorded_actions(log, steps)
    assert {key: answer.action for key, answer in again.answers.items()} == {
        key: answer.action for key, answer in records.answers.items()
    }
    assert again.outcomes == {}
