"""A small synthetic release, and the smallest training on it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import rema_data
from baselines.tae.network import Architecture
from baselines.train.config import TrainingConfig
from rema_data.testing import make_release

SMALL = Architecture(width=4)


@pytest.fixture(scope="session")
def release(tmp_path_factory: pytest.TempPathFactory) -> rema_data.Release:
    """Three tasks, both splits. Only to be read."""
    made = make_release(tmp_path_factory.mktemp("releases"), tasks=("grasp", "push", "grasp_push"), episodes=30)
    return rema_data.Release(made, cache=tmp_path_factory.mktemp("decoded"))


@pytest.fixture(scope="session")
def config() -> TrainingConfig:
    """Nine updates with three validations."""
    return TrainingConfig("grasp", ("grasp", "grasp_push"), updates=9, validate_every=3, architecture=SMALL)


def tree(folder: Path) -> dict[str, object]:
    """Every file of a folder of networks; cards without the commit of the code."""
    return {
        path.name: {**json.loads(path.read_bytes()), "commit": ""} if path.suffix == ".json" else path.read_bytes()
        for path in folder.iterdir()
    }
