"""The protocol in words, and its hash."""

from __future__ import annotations

import dataclasses
import json

import pytest

import evaluator.protocol
from evaluator.protocol import PROTOCOLS, protocol, protocol_hash
from evaluator.sim.parameters import WORLD, parameters_hash
from rema_data.errors import InputError
from rema_data.schema import TASKS


def test_every_task_and_protocol_has_its_own_hash() -> None:
    hashes = {protocol_hash(task, name) for task in TASKS for name in PROTOCOLS}
    assert len(hashes) == len(TASKS) * len(PROTOCOLS)
    assert all(len(text) == 64 for text in hashes)


@pytest.mark.parametrize("task", TASKS)
def test_it_is_json_and_says_what_counts(task: str) -> None:
    described = protocol(task, "conditional")
    assert json.loads(json.dumps(described)) == described
    assert described["parameters_hash"] == parameters_hash()
    assert len(described["steps"]) == len(TASKS[task])
    assert described["scored_steps"] == [len(TASKS[task]) - 1]
    if task.endswith("push"):
        assert f"{WORLD.push_success_m:g} m further in +x" in described["steps"][-1]["success"]


def test_another_world_is_another_protocol(monkeypatch: pytest.MonkeyPatch) -> None:
    before = protocol_hash("grasp", "conditional")
    other = dataclasses.replace(WORLD, object_friction=0.5)
    monkeypatch.setattr(evaluator.protocol, "parameters_hash", lambda: parameters_hash(other))
    assert protocol_hash("grasp", "conditional") != before


def test_what_is_unknown_is_refused() -> None:
    with pytest.raises(InputError, match="grasp_push"):
        protocol("fly", "conditional")
    with pytest.raises(InputError, match="end-to-end"):
        protocol("grasp", "best-of-three")
