"""From a file to the board, with the commands of docs/submit.md, over a small list."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from evaluator.cli.main import cli
from tests.evaluator.report.conftest import EPISODES, write_push_list

ROOT = Path(__file__).parents[2]


def test_a_policy_of_ones_own_comes_onto_the_board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_push_list(tmp_path / "manifests")
    shutil.copytree(ROOT / "manifests" / "published", tmp_path / "manifests" / "published")
    shutil.copy(ROOT / "examples" / "my_policy.py", tmp_path)
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.chdir(tmp_path)

    def rema(*words: str) -> str:
        done = CliRunner().invoke(cli, words, prog_name="rema")
        assert done.exit_code == 0, done.stderr
        return done.stdout

    for policy in ("my_policy.py", "random"):
        rema("evaluate", policy, "--task", "push", "--episodes", str(EPISODES), "--workers", "1")
    assert "my_policy" in rema("compare", "runs/my_policy-push-conditional", "runs/random-push-conditional")
    rema("report", "runs/my_policy-push-conditional")
    assert (tmp_path / "runs" / "my_policy-push-conditional" / "report.html").stat().st_size > 10_000
    rema("replay", "runs/my_policy-push-conditional", "--fraction", "0.5")
    told = rema("submit", "runs/my_policy-push-conditional", "--link", "https://example.org/my-paper")
    assert "checks passed" in told
    summary = json.loads((tmp_path / "runs" / "my_policy-push-conditional" / "summary.json").read_text())
    board = json.loads(rema("leaderboard", "my_policy-push-conditional.json", "runs/random-push-conditional", "--json"))
    rows = {row["policy"]: row for row in board["rows"] if row["tag"] != "published"}
    assert rows.keys() == {"my_policy", "random"} and rows["my_policy"]["tag"] == "submitted"
    assert rows["my_policy"]["successes"] == summary["successes"]
