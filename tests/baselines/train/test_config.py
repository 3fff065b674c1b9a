"""Configurations say what can be trained, and refuse the rest by name."""

from __future__ import annotations

import json
from typing import Any

import pytest

from baselines.tae.network import Architecture
from baselines.train.config import TrainingConfig, skills_of
from rema_data.errors import InputError
from rema_data.validation import plain, validated


def test_skills_follow_from_tasks_and_primitive() -> None:
    assert skills_of("grasp", ("grasp_push",)) == ("grasp",)  # the tool pick
    assert skills_of("grasp", ("grasp", "grasp_grasp")) == ("grasp", "grasp_grasp")
    assert skills_of("push", ("push", "grasp_push")) == ("push", "grasp_push")
    config = TrainingConfig("grasp", ("grasp_grasp",), skills=("grasp_grasp",))
    assert config.learned_skills == ("grasp_grasp",)


def test_a_configuration_survives_json() -> None:
    config = TrainingConfig(
        "push", ("push",), shares={"push": 2}, updates=5, schedule="cosine", architecture=Architecture(8, ee_stride=2)
    )
    assert validated(TrainingConfig, json.loads(json.dumps(plain(config))), "a card") == config


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"primitive": "throw"}, "primitive"),
        ({"tasks": []}, "tasks is \\[\\]"),
        ({"tasks": ["juggle"]}, "juggle"),
        ({"tasks": "grasp"}, "tasks is 'grasp'"),
        ({"tasks": [["grasp"]]}, "tasks"),
        ({"skills": [3]}, "skills"),
        ({"primitive": ["grasp"]}, "primitive"),
        ({"tasks": ["push"]}, "no grasp step"),
        ({"skills": ["push"]}, "skill push"),
        ({"updates": 0}, "updates"),
        ({"seed": 2**64}, "seed"),
        ({"updates": 1.5}, "updates"),
        ({"learning_rate": 0.0}, "learning_rate"),
        ({"learning_rate": float("nan")}, "learning_rate"),
        ({"learning_rate": "1e-3"}, "learning_rate"),
        ({"learning_rate": None}, "learning_rate"),
        ({"learning_rate": True}, "learning_rate"),
        ({"rotate": "no"}, "rotate"),
        ({"mirror": 1}, "mirror"),
        ({"schedule": "linear"}, "schedule"),
        ({"architecture": 5}, "architecture"),
        ({"architecture": None}, "architecture"),
        ({"momentum": 0.9}, "momentum"),
        ({"shares": {"push": 2}}, "shares names 'push'; skills that are learned: grasp"),
        ({"shares": {"grasp": 0}}, "shares.grasp is 0"),
        ({"shares": {"grasp": "2"}}, "shares.grasp is '2'"),
        ({"hard_share": 1.5}, "hard_share"),
        ({"hard_every": 0}, "hard_every"),
        ({"architecture": {"width": 3}}, "width"),
        ({"architecture": {"width": 8.0}}, "architecture.width is 8.0"),
        ({"architecture": {"width": True}}, "architecture.width is True"),
        ({"architecture": {"depth": 8}}, "architecture.depth is not a known field"),
    ],
)
def test_impossible_configurations_are_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        validated(TrainingConfig, {"primitive": "grasp", "tasks": ["grasp"], **values}, "plan.toml")
    assert caught.value.hint and caught.value.message.startswith("plan.toml: ")


@pytest.mark.parametrize("missing", ["primitive", "tasks"])
def test_missing_fields_are_named(missing: str) -> None:
    values = {"primitive": "grasp", "tasks": ["grasp"]}
    del values[missing]
    with pytest.raises(InputError, match=f"{missing} is missing"):
        validated(TrainingConfig, values, "plan.toml")
