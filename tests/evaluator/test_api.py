"""The Python API: its names, and what it costs to import."""

from __future__ import annotations

import inspect
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import evaluator
from evaluator.cli.evaluate import evaluate as command
from rema_data.errors import InputError

NAMES = ["check_policy", "compare", "evaluate", "leaderboard", "read_run", "replay"]


def test_the_public_names() -> None:
    assert sorted(evaluator.__all__) == NAMES
    assert set(NAMES) <= set(dir(evaluator))
    with pytest.raises(AttributeError, match="no attribute 'score'"):
        evaluator.score  # noqa: B018


def test_it_offers_what_the_command_offers() -> None:
    arguments = set(inspect.signature(evaluator.evaluate).parameters) - {"progress"}
    assert {parameter.name for parameter in command.params} - {"as_json"} == arguments


def run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_importing_it_loads_nothing() -> None:
    assert run("import sys, evaluator; print(*{'numpy', 'pyarrow', 'pybullet', 'torch'} & set(sys.modules))") == ""


@pytest.mark.parametrize(
    "first", ["", "import evaluator.replay.play, evaluator.leaderboard.board", "from evaluator import *"]
)
def test_the_names_are_functions_in_any_order_of_imports(first: str) -> None:
    """``leaderboard`` and ``replay`` are packages too, which their functions must not hide."""
    code = f"{first}\nimport evaluator\nprint(all(callable(getattr(evaluator, name)) for name in {NAMES}))\n"
    code += "from evaluator import leaderboard\nprint(len(leaderboard([], entries=False).rows) > 0)\n"
    code += "from evaluator.leaderboard import Board\nimport evaluator.replay.play as p\nprint(p.__name__)"
    assert run(code).split() == ["True", "True", "evaluator.replay.play"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"episodes": 0}, "--episodes 0 is not a positive number"),
        ({"episodes": -5}, "--episodes -5 is not a positive number"),
        ({"task": "juggle"}, "juggle"),
        ({"workers": -1}, "workers"),
        ({"protocol": "by heart"}, "by heart"),
        ({"batch_size": 0}, "--batch-size 0 is not a positive number"),
    ],
)
@pytest.mark.parametrize("listed", [{}, {"fresh": 1}], ids=["frozen", "fresh"])
def test_what_cannot_be_used_is_refused_before_anything_is_drawn(
    arguments: dict[str, Any], words: str, listed: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    given = {"task": "grasp", "output": tmp_path / "run", **arguments, **listed}
    with pytest.raises(InputError, match=words):
        evaluator.evaluate("random", **given)
    assert list(tmp_path.iterdir()) == []
