"""`rema leaderboard`: the table, the exports, and what is said about bad runs."""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from evaluator.cli.main import cli
from tests.evaluator.runs import EPISODES, reseal, solved, use_installation, write_entry, write_run

Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """``write(name, success, ...)`` writes ``runs/name`` below the working folder."""
    use_installation(tmp_path, monkeypatch)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "140")

    def run(name: str, success: Any, **changes: Any) -> Path:
        return write_run(tmp_path / "runs" / name, success, **{"policy": name, **changes})

    return run


def board(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["leaderboard", *map(str, arguments)], prog_name="rema")


def test_the_table(write: Write) -> None:
    random, mine = solved(0.06, 1), solved(0.7, 2)
    result = board(write("random", random), write("my_policy", mine))
    assert result.exit_code == 0, result.stderr
    lines = result.stdout.splitlines()
    assert lines[0].startswith("grasp, conditional (scenarios ")
    ranked = [line.split()[:2] for line in lines if f"/{EPISODES}" in line]
    assert ranked == [["my_policy", "submitted"], ["random", "random"]]
    assert f"{random.sum()}/{EPISODES}" in result.stdout and f"missed {(~mine).sum()}" in result.stdout
    assert "push, conditional" not in result.stdout
    assert "Its scenes and its simulator are not" in " ".join(result.stdout.split())


@pytest.mark.parametrize("columns", [60, 80, 100])
def test_narrow_terminals_keep_every_cell_whole(write: Write, monkeypatch: pytest.MonkeyPatch, columns: int) -> None:
    monkeypatch.setattr("evaluator.cli.output.terminal_width", lambda: columns)
    mine = solved(0.7, 2)
    result = board(write("my_policy", mine), write("a_policy_with_a_long_name", solved(0.4, 3)))
    row = next(line for line in result.stdout.splitlines() if "my_policy" in line)
    assert f"{mine.sum()}/{EPISODES}" in row and f"{100 * mine.mean():.1f}" in row
    header = next(line for line in result.stdout.splitlines() if "policy" in line and "rate %" in line)
    words = " ".join(result.stdout.split())
    assert ("failures" in header) != ("failures" in words.partition("no room for all of: ")[2].partition(";")[0])
    rows = [line for line in result.stdout.splitlines() if f"/{EPISODES}" in line]
    assert "a_policy_with_a_long_name" in result.stdout and all(len(line) <= columns for line in rows)


def test_runs_are_found_below_runs(write: Write) -> None:
    assert "> 10000" in board().stdout
    assert "no runs" in board("--no-published").stdout
    mine = solved(0.7, 2)
    write("my_policy", mine)
    assert f"{mine.sum()}/{EPISODES}" in board("--no-published").stdout


def test_entries_that_come_with_the_installation_are_shown(write: Write, tmp_path: Path) -> None:
    entry = tmp_path / "manifests" / "leaderboard" / "theirs.json"
    write_entry(entry, write("theirs", solved(0.5, 1)), policy="them")
    assert "them" in board("--no-published").stdout
    shown = board("--no-published", "--no-entries").stdout
    assert "theirs" in shown and "them " not in shown
    entry.write_text(entry.read_text().replace("them", "thee"))
    result = board()
    assert result.exit_code == 6 and "theirs.json is refused" in result.stderr


def test_what_is_not_verified_stands_apart_until_it_is_simulated(write: Write, tmp_path: Path) -> None:
    """A run that claims successes, of another simulator: --verify simulates its actions in the world that is here."""
    honest, claimed = write("honest", solved(0.5, 1)), write("claimed", np.ones(EPISODES, bool), verified=False)
    shown = board(honest, claimed, "--no-published").stdout
    assert "grasp, conditional: not verified" in shown and "rema leaderboard --verify" in shown
    result = board(honest, claimed, "--no-published", "--verify")
    assert result.exit_code == 0 and "outcomes are others in the simulator here" in " ".join(result.stdout.split())
    assert "verify:" in result.stderr and "grasp, conditional: not verified" in result.stdout


def test_a_record_is_written_for_entries_of_the_installation_alone(write: Write, tmp_path: Path) -> None:
    assert "nothing to record" in board("--record").stderr
    entry = write_entry(tmp_path / "mine.json", write("mine", solved(0.5, 1)))
    result = board(entry, "--record")
    assert result.exit_code == 2 and "copy it there first" in result.stderr


@pytest.mark.parametrize("form", ["md", "html", "tex", "csv", "json"])
def test_exports_have_a_row_for_every_policy(write: Write, form: str) -> None:
    result = board(write("my_policy", solved(0.7, 2)), "--export", form)
    assert result.exit_code == 0, result.stderr
    assert result.stdout.count("published") >= 4
    assert ("my_policy" if form != "tex" else r"my\_policy") in result.stdout


def test_json_is_an_object_alone(write: Write) -> None:
    mine = solved(0.7, 2)
    run = write("my_policy", mine)
    whole = json.loads(board(run, "--json").stdout)
    (ours,) = [row for row in whole["rows"] if row["tag"] == "submitted"]
    assert (ours["successes"], ours["episodes"], ours["rank"]) == (mine.sum(), EPISODES, 1)
    assert board(run, "--export", "json").stdout == board(run, "--json").stdout
    table = list(csv.DictReader(io.StringIO(board(run, "--export", "csv").stdout)))
    assert [row["policy"] for row in table] == [row["policy"] for row in whole["rows"]]


def test_bad_runs(write: Write, tmp_path: Path) -> None:
    result = board(tmp_path / "none", write("there", solved(0.5, 3)))
    assert result.exit_code == 2 and "does not exist" in result.stderr and not result.stdout
    (tmp_path / "empty").mkdir()
    result = board(tmp_path / "empty")
    assert result.exit_code == 2 and "holds no finished run" in result.stderr
    broken = write("broken", solved(0.7, 2))
    for content in ("{", "[]", "{}", '{"task": "grasp"}'):
        (broken / "summary.json").write_text(content)
        result = board(broken)
        assert result.exit_code == 6 and "broken is refused: summary.json" in result.stderr
        header = json.loads((broken / "run.json").read_text())
        unsealed = tmp_path / "runs" / "unsealed"
        shutil.copytree(broken, unsealed)
        del header["seal"]
        (unsealed / "run.json").write_text(json.dumps(header))
        result = board(unsealed)
        assert result.exit_code == 2 and "unsealed is not sealed" in result.stderr
        shutil.rmtree(unsealed)
    odd = reseal(write("odd", solved(0.5, 1)), protocol_hash=3, policy="\x1b[2J", task="fly")
    result = board(odd)
    assert result.exit_code == 6 and "\x1b" not in result.stderr and "Traceback" not in result.stderr
    said = " ".join(result.stderr.split())
    assert 'task says "fly", run.json gives "grasp"' in said and "protocol_hash says 3" in said
