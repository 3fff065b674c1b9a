"""``rema replay``: what it prints, and its exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

import evaluator.replay.play
from evaluator.cli.main import cli
from evaluator.runner import run_evaluation
from evaluator.scenarios import VERSION
from tests.evaluator.fakes import fake_backend, fake_config


@pytest.fixture
def run(fake_home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A finished run, in the working folder."""
    monkeypatch.setattr(evaluator.replay.play, "default_backend", fake_backend)
    monkeypatch.chdir(fake_home)
    run_evaluation(fake_config(Path("run"), episodes=60, engine="inline"), backend=fake_backend())
    return fake_home / "run"


def rema(*arguments: str, **more: str) -> Result:
    return CliRunner().invoke(cli, arguments, prog_name="rema", **more)


def replay(*arguments: str, **more: str) -> Result:
    return rema("replay", "run", "--engine", "inline", *arguments, **more)


def spoil(run: Path) -> None:
    path = run / "actions.bin"
    path.write_bytes(bytes([path.read_bytes()[0] ^ 1]) + path.read_bytes()[1:])


def test_a_true_run(run: Path) -> None:
    result = replay()
    assert result.exit_code == 0, result.stderr
    assert "nothing is wrong" in result.stdout and "0 of 60" in result.stdout and "its own audit" in result.stdout
    assert "replay: 60/60" in result.stderr
    part = replay("--fraction", "0.25", "--seed", "7")
    assert "15 episodes, drawn with seed 7" in part.stdout and "at most 21.80 % of all" in part.stdout
    shown = json.loads(replay("--json", "--fraction", "0").stdout)
    assert shown["ok"] is True and shown["findings"] == [] and len(shown["seal"]) == 64


def test_a_tampered_run(run: Path) -> None:
    spoil(run)
    result = replay()
    assert result.exit_code == 6
    assert "actions.bin" in result.stdout and f"row 0 ({VERSION}/grasp/test/00000)" in result.stdout.replace("\n", " ")
    assert "nothing is wrong" not in result.stdout
    shown = replay("--json")
    assert shown.exit_code == 6
    (finding,) = json.loads(shown.stdout)["findings"]
    assert finding["file"] == "actions.bin" and finding["where"].startswith("row 0 ")


def test_another_simulator(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REMA_FAKE_PARAMETERS", "other")
    result = replay()
    assert result.exit_code == 6, "60 episodes without a flip do not show that at most 0.5 % would be others"
    assert "parameters is other here, p in the run" in result.stdout and "flips" in result.stdout
    assert "not verified" in result.stdout and "nothing is wrong" not in result.stdout


def test_what_is_no_finished_run(run: Path, tmp_path: Path) -> None:
    nothing = rema("replay", str(tmp_path / "nothing"))
    assert nothing.exit_code == 2 and "holds no finished run" in nothing.stderr
    (run / "run.json").write_text("{")
    assert replay().exit_code == 6
    assert rema("replay", "run", "--fraction", "2").exit_code == 2
    alone = replay("--address", "local")
    assert alone.exit_code == 2 and "--address is for an engine on a cluster" in alone.stderr
