"""The identity of a collection follows the code that decides outcomes and observations, and no other code."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
IDENTITY = "from evaluator.rollout.backend import default_backend as made; print(made().observation_hash)"


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("code")
    for name in ("rema_data", "evaluator"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def identity(folder: Path) -> str:
    environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", IDENTITY], cwd=folder, env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.split("\n")[-2]


def edited(folder: Path, file: str) -> str:
    """The identity after a line is added to a file, which is put back."""
    path = folder / file
    before = path.read_bytes()
    path.write_bytes(before + b"\nEDITED = True\n")
    try:
        return identity(folder)
    finally:
        path.write_bytes(before)


def test_what_decides_an_outcome_is_in_the_identity_and_a_picture_is_not(copied: Path) -> None:
    before = identity(copied)
    for file in ("evaluator/render/studio.py", "evaluator/render/arms.py", "evaluator/report/page.py"):
        assert edited(copied, file) == before, file
    for file in ("evaluator/sim/kinds/push.py", "evaluator/sim/world.py", "rema_data/grid.py", "rema_data/schema.py"):
        assert edited(copied, file) != before, file
    assert identity(copied) == before
