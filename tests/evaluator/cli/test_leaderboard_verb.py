"""`rema leaderboard`: the table, the exports, and what is said about bad runs."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from evaluator.cli.main import cli

WriteRun = Callable[..., Path]


def board(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["leaderboard", *map(str, arguments)], prog_name="rema")


def test_the_table(write_run: WriteRun) -> None:
    run = write_run("a")
    result = board(run, write_run("b", policy="my_policy", successes=700, failures={"slipped": 300}))
    assert result.exit_code == 0, result.stderr
    lines = result.stdout.splitlines()
    assert lines[0].startswith("grasp, conditional")
    order = [next(n for n, line in enumerate(lines) if name in line) for name in ("joint", "my_policy", "random")]
    assert order == sorted(order)
    assert "56/1000" in result.stdout and "slipped" in result.stdout and "submitted" in result.stdout
    assert "push, conditional" not in result.stdout
    assert "Its scenes and its simulator are not" in " ".join(result.stdout.split())


def test_narrow_terminals_keep_every_number_whole(write_run: WriteRun, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    result = board(write_run("a"))
    assert "56/1000" in result.stdout and "missed" not in result.stdout and "…" not in result.stdout
    assert all(line.strip() for line in result.stdout.splitlines()[2:8])


def test_runs_are_found_below_runs(write_run: WriteRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert "> 10000" in board().stdout
    assert "no runs" in board("--no-published").stdout
    write_run("a")
    assert "56/1000" in board("--no-published").stdout


def test_exports(write_run: WriteRun) -> None:
    run = write_run("a")
    rows = json.loads(board(run, "--json").stdout)["rows"]
    ours = next(row for row in rows if row["tag"] == "random")
    assert (ours["successes"], ours["episodes"], ours["policy_errors"]) == (56, 1000, 4)
    assert abs(ours["z"] - 0.09) < 0.05
    table = list(csv.DictReader(io.StringIO(board(run, "--export", "csv").stdout)))
    assert len(table) == len(rows) and table[-1]["policy"] in ("random",)
    markdown = board(run, "--export", "md").stdout
    assert "| grasp | random | random | conditional | 56/1000 | 5.6 |" in markdown
    assert board(run, "--export", "json").stdout == board(run, "--json").stdout


def test_bad_runs(write_run: WriteRun, tmp_path: Path) -> None:
    result = board(tmp_path / "none")
    assert result.exit_code == 2 and "holds no finished run" in result.stderr
    broken = write_run("broken")
    (broken / "summary.json").write_text("{")
    assert board(broken).exit_code == 2
    (broken / "summary.json").write_text("[]")
    assert board(broken).exit_code == 2
    result = board(write_run("odd", task="fly"))
    assert result.exit_code == 2 and "unknown task 'fly'" in result.stderr and "Traceback" not in result.stderr
