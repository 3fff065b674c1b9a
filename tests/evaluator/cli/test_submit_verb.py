"""`rema submit`: the entry, the verdict, and its exit codes."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner, Result

from evaluator.cli.main import cli
from evaluator.leaderboard import submission
from evaluator.run.entry import read_entry
from tests.evaluator.runs import EPISODES, STOPPED, solved, use_installation, write_run

PASSED = solved(0.6, 1)


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    use_installation(tmp_path, monkeypatch)
    monkeypatch.chdir(tmp_path)
    report = SimpleNamespace(findings=(), verified=True)
    monkeypatch.setattr(submission, "replay", lambda folder, **_: report)  # its outcomes are made up
    return write_run(tmp_path / "run", PASSED)


def submit(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["submit", *map(str, arguments)], prog_name="rema")


def test_an_entry_is_written_and_read_by_the_leaderboard(run: Path) -> None:
    result = submit(run, "--name", "ours", "--link", "https://example.org")
    assert result.exit_code == 0, result.stderr
    path = Path("ours-grasp-conditional.json")
    assert f"entry: {path}" in result.stdout and "checks passed" in result.stdout
    assert read_entry(path).actions.shape == (EPISODES, 1)
    table = CliRunner().invoke(cli, ["leaderboard", str(path), "--no-published", "--json"])
    (row,) = json.loads(table.stdout)["rows"]
    assert (row["policy"], row["rank"], row["link"]) == ("ours", 1, "https://example.org")
    assert row["successes"] == PASSED.sum()


def test_the_same_run_is_the_same_entry_and_another_is_not_overwritten(run: Path, tmp_path: Path) -> None:
    assert submit(run, "--output", "e.json").exit_code == 0
    first = Path("e.json").read_bytes()
    assert submit(run, "--output", "e.json").exit_code == 0 and Path("e.json").read_bytes() == first
    other = write_run(tmp_path / "other", solved(0.2, 3), policy="other")
    result = submit(other, "--output", "e.json")
    assert result.exit_code == 2 and "is there already" in result.stderr and Path("e.json").read_bytes() == first


def test_checking_writes_nothing(run: Path, tmp_path: Path) -> None:
    before = sorted(tmp_path.iterdir())
    result = submit(run, "--check", "--json")
    content = json.loads(result.stdout)
    assert result.exit_code == 0 and content["valid"] and content["entry"] is None
    assert all(check["passed"] for check in content["checks"]) and sorted(tmp_path.iterdir()) == before


def test_a_run_that_is_no_submission_ends_with_three_and_says_why(run: Path, tmp_path: Path) -> None:
    short = write_run(tmp_path / "short", PASSED[:100], stopped_early=STOPPED)
    result = submit(short)
    assert result.exit_code == 3
    assert "episodes: 100; must be 300" in result.stderr and "stopped_early: true; must be false" in result.stderr
    content = json.loads(submit(short, "--json").stdout)
    assert not content["valid"]
    assert [check["what"] for check in content["checks"] if not check["passed"]] == ["stopped_early", "episodes"]
    assert not list(tmp_path.glob("*-grasp-*.json"))


def test_bad_input(run: Path, tmp_path: Path) -> None:
    assert submit(tmp_path / "none").exit_code == 2
    assert submit(run, "--name", "two words").exit_code == 2
    assert submit(run, "--name", "random").exit_code == 3
