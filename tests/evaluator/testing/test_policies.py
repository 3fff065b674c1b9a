"""The pytest class for policies: as a package with a policy of its own uses it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from evaluator.testing.policies import PolicyContract

BROKEN = """
import numpy as np
from evaluator.testing.policies import PolicyContract
class Policy:
    def __init__(self, checkpoint, device): pass
    def act(self, observations):
        return np.random.default_rng().choice(np.flatnonzero(observations.valid[0]), len(observations))
class TestMine(PolicyContract):
    policy = __file__
    task = "grasp"
"""


class TestRandom(PolicyContract):
    policy = "random"


def test_a_broken_policy_fails_where_it_is_broken(tmp_path: Path) -> None:
    (tmp_path / "test_mine.py").write_text(BROKEN)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull, "test_mine.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1, done.stdout
    assert "3 passed" in done.stdout and "4 failed" in done.stdout
    assert "to fix this: answer from the observation alone" in done.stdout
