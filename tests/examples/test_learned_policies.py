"""The learned policies of examples/, from the sample to a score, by the commands that their docstrings show.

The sample has 100 random and 100 scripted attempts of a task to learn from. Random actions succeed in one scenario of
twenty (grasp) and in one of six (push): more than half is out of reach of chance, and in reach of seconds of training.
The benchmark of the examples scores both policies in both tasks.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.examples.commands import example, python, rema

EPISODES = 24


class Learned(NamedTuple):
    """A policy, the words that train it at a reduced size, its checkpoint, and the package that it needs."""

    policy: str
    training: tuple[str, ...]
    checkpoint: str
    package: str

    def train(self, folder: Path) -> None:
        """Train in a folder."""
        pytest.importorskip(self.package)
        script, *words = self.training
        done = python(example(script), "--release", "rema-sample", *words, "--output", self.checkpoint, cwd=folder)
        assert done.returncode == 0, done.stderr
        assert done.stdout.endswith(f"{self.checkpoint}\n")


TORCH = Learned("torch_policy", ("train", "--batches", "300"), "weights.safetensors", "torch")
SKLEARN = Learned("sklearn_policy", ("sklearn_policy", "--trees", "50"), "trees.joblib", "sklearn")
both = pytest.mark.parametrize("learned", [TORCH, SKLEARN], ids=lambda learned: learned.policy)


@pytest.mark.parametrize(("learned", "task"), [(TORCH, "grasp"), (SKLEARN, "push")], ids=["torch", "sklearn"])
def test_trained_on_the_sample_it_is_far_better_than_random(learned: Learned, task: str, tmp_path: Path) -> None:
    learned.train(tmp_path)
    words = ["--checkpoint", learned.checkpoint, "--split", "val", "--episodes", str(EPISODES), "--workers", "1"]
    done = rema("evaluate", example(learned.policy), "--task", task, *words, "--output", "run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["policy_errors"] == 0 and summary["eligible"] == EPISODES
    assert re.search(rf"successes +{summary['successes']} of {EPISODES} eligible episodes", done.stdout)
    assert summary["successes"] > EPISODES // 2


@both
def test_without_a_checkpoint_the_user_is_told_how_to_make_one(learned: Learned, tmp_path: Path) -> None:
    pytest.importorskip(learned.package)
    done = rema("evaluate", example(learned.policy), "--task", "grasp", "--episodes", "2", cwd=tmp_path)
    assert done.returncode == 3
    assert f"python examples/{learned.training[0]}.py makes them, and --checkpoint names them" in done.stderr


@both
def test_the_commands_of_the_docstring_name_what_there_is(learned: Learned) -> None:
    text = Path(example(learned.policy)).read_text(encoding="utf-8").split('"""')[1]
    assert f"python examples/{learned.training[0]}.py --output {learned.checkpoint}" in text
    assert f"rema evaluate examples/{learned.policy}.py --checkpoint {learned.checkpoint} --task grasp" in text
