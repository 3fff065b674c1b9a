"""The command, the runner and real policy processes together, over a world that takes no time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

import evaluator.runner.run
from evaluator.cli.main import cli
from evaluator.policy import digest
from evaluator.protocol import protocol_hash
from evaluator.runner import default_backend
from tests.evaluator.fakes import fake_backend


@pytest.fixture
def world(fake_home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    parts: dict[str, Any] = {
        "open_policy": default_backend().open_policy,
        "policy_digest": digest,
        "protocol_hash": protocol_hash,
    }
    monkeypatch.setattr(evaluator.runner.run, "default_backend", lambda: fake_backend(**parts))
    monkeypatch.chdir(fake_home)
    return fake_home


def rema(*arguments: str) -> Result:
    return CliRunner().invoke(cli, arguments, prog_name="rema")


def evaluate(policy: str, *more: str, episodes: int = 150) -> Result:
    return rema("evaluate", policy, "--task", "grasp", "--episodes", str(episodes), "--engine", "inline", *more)


def test_a_built_in_is_scored_resumed_and_extended(world: Path) -> None:
    first = evaluate("random", "--json")
    assert first.exit_code == 0, first.stderr
    summary = json.loads(first.stdout)
    assert (summary["policy"], summary["eligible"], summary["policy_errors"]) == ("random", 150, 0)
    table = (world / "runs/random-grasp-conditional/results.parquet").read_bytes()
    again = evaluate("random")
    assert "resumed at 150/150" in again.stderr and "(95 %)" in again.stdout
    assert (world / "runs/random-grasp-conditional/results.parquet").read_bytes() == table
    assert json.loads(evaluate("random", "--json", episodes=200).stdout)["eligible"] == 200


def test_privilege_is_recorded(world: Path) -> None:
    summary = json.loads(evaluate("scripted", "--json").stdout)
    assert summary["privileged"] is True and summary["policy_errors"] == 0


def test_a_policy_with_a_few_faults_is_scored(world: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("mine.py").write_text(
        "import numpy as np\n"
        "class Policy:\n"
        "    def __init__(self, checkpoint, device): pass\n"
        "    def act(self, o):\n"
        "        if (np.rint(o.scene[:, 0, 0] * 1e4) % 20 == 0).any(): raise ValueError('not this one')\n"
        "        return np.tile([30, 30, 1], (len(o.scene), 1))\n"
    )
    result = evaluate("mine.py", "--batch-size", "16", "--json")
    assert result.exit_code == 0, result.stderr
    summary = json.loads(result.stdout)
    assert 0 < summary["policy_errors"] < 15 and summary["eligible"] == 150
    assert summary["failures"]["policy_error"] == summary["policy_errors"]
    monkeypatch.delenv("REMA_MANIFESTS")  # the fake lists have no published rates beside them
    board = rema("leaderboard", "runs/mine-grasp-conditional")
    assert board.exit_code == 0 and "mine" in board.stdout and "submitted" in board.stdout


@pytest.mark.parametrize(
    ("code", "exit_code", "words"),
    [
        ("import nothing_of_that_name", 3, "No module named 'nothing_of_that_name'"),
        ("class Police: pass", 3, "it defines Police"),
        ("class Policy:\n    def __init__(s, c, d): pass\n    def act(s, o): return o.scene", 4, "wrong_shape"),
        ("class Policy:\n    def __init__(s, c, d): pass\n    def act(s, o): raise KeyError('x')", 4, "KeyError"),
    ],
)
def test_a_bad_policy_ends_with_its_exit_code(world: Path, code: str, exit_code: int, words: str) -> None:
    Path("bad.py").write_text(code)
    result = evaluate("bad.py")
    assert result.exit_code == exit_code
    assert words in result.stderr and result.stdout == ""


def test_a_changed_policy_does_not_continue_a_run(world: Path) -> None:
    code = "import numpy as np\nclass Policy:\n    def __init__(s, c, d): pass\n    def act(s, o): "
    Path("mine.py").write_text(code + "return np.tile([30, 30, 1], (len(o.scene), 1))\n")
    assert evaluate("mine.py").exit_code == 0
    Path("mine.py").write_text(code + "return np.tile([30, 30, 2], (len(o.scene), 1))\n")
    result = evaluate("mine.py")
    assert result.exit_code == 2 and "policy_digest" in result.stderr


def test_prints_are_kept_and_named(world: Path) -> None:
    Path("bad.py").write_text(
        "print('loaded', flush=True)\nclass Policy:\n    def __init__(s, c, d): pass\n"
        "    def act(s, o): raise ValueError('no \\x1b[2J idea')\n"
    )
    result = evaluate("bad.py")
    log = world / "runs/bad-grasp-conditional/policy.log"
    assert result.exit_code == 4 and "policy.log" in result.stderr
    assert log.read_text() == "loaded\n"
    assert "\x1b[2J" not in result.stderr
    Path("bad.py").write_text("print('oh', flush=True)\nimport nothing_of_that_name")
    result = evaluate("bad.py", "--output", "fresh")
    assert result.exit_code == 3 and "oh" in (world / "fresh/policy.log").read_text()
    assert "fresh/policy.log" in result.stderr
    Path("bad.py").write_text("class Police: pass")
    assert evaluate("bad.py:Police", "--output", "quiet").exit_code == 3
    assert not (world / "quiet/policy.log").exists()


def test_a_fixed_policy_may_use_its_folder(world: Path) -> None:
    Path("mine.py").write_text("import nothing_of_that_name")
    assert evaluate("mine.py").exit_code == 3
    Path("mine.py").write_text(
        "import numpy as np\nclass Policy:\n    def __init__(s, c, d): pass\n"
        "    def act(s, o): return np.tile([30, 30, 1], (len(o.scene), 1))\n"
    )
    assert evaluate("mine.py").exit_code == 0


def test_terminal_without_blocks(world: Path) -> None:
    assert evaluate("random").exit_code == 0
    summary = (world / "runs/random-grasp-conditional/summary.json").read_text()
    code = (
        "import json, sys\nfrom pathlib import Path\nfrom evaluator.cli.result import print_result\n"
        f"print_result(json.loads({summary!r}), Path('r'), False)"
    )
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path),
        "PYTHONIOENCODING": "ascii",
    }
    said = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, check=True).stdout
    assert b"####" in said
