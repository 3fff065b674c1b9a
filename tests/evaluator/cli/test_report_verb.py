"""``rema report``: where the page goes, what is printed, and refusals in a sentence."""

from __future__ import annotations

import builtins
import json
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from evaluator.cli.main import VERBS, cli
from evaluator.runner import run_evaluation
from tests.evaluator.fakes import fake_backend, fake_config


@pytest.fixture
def run(fake_home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run of the fake world, which a page without episodes needs no physics for."""
    folder = fake_home / "runs" / "fake"
    run_evaluation(fake_config(folder, engine="inline", audit_share=0.0), backend=fake_backend())
    monkeypatch.chdir(fake_home)
    return folder


def report(*arguments: str) -> Result:
    return CliRunner().invoke(cli, ["report", *arguments], prog_name="rema")


def test_the_verb_is_in_the_help() -> None:
    assert "report" in VERBS
    assert "self-contained HTML page" in report("--help").output


def test_the_page_lies_in_the_run_folder(run: Path) -> None:
    result = report(str(run), "--per-label", "0")
    assert result.exit_code == 0, result.stderr
    assert result.stdout == f"{run / 'report.html'}: 0.0 MB, 0 episodes\n"
    summary = json.loads((run / "summary.json").read_text())
    assert f"{summary['successes']} of {summary['eligible']} eligible" in (run / "report.html").read_text()


def test_json_is_printed_alone(run: Path) -> None:
    target = run.parent / "pages" / "a.html"
    result = report(str(run), "--per-label", "0", "--output", str(target), "--json")
    assert result.exit_code == 0, result.stderr
    printed = json.loads(result.stdout)
    assert printed == {
        "file": str(target),
        "bytes": target.stat().st_size,
        "episodes_shown": 0,
        "played_again": {},
        "episodes_scored": 0,
        "pictures_left_out": 0,
    }
    assert not (run / "report.html").exists()


def test_reporting_changes_nothing_else_in_the_run(run: Path) -> None:
    before = {path.name: path.read_bytes() for path in run.iterdir() if path.is_file()}
    assert report(str(run), "--per-label", "0").exit_code == 0
    after = {path.name: path.read_bytes() for path in run.iterdir() if path.is_file()}
    del after["report.html"]
    assert after == before


@pytest.mark.parametrize(
    ("arguments", "sentence", "code"),
    [
        (("nowhere",), "nowhere holds no finished run", 2),
        (("runs/fake", "--checkpoint", "weights"), "--checkpoint belongs to a policy", 2),
        (("runs/fake", "--sandbox", "env"), "--sandbox belongs to a policy", 2),
        (("runs/fake", "--policy", "nobody"), "no policy is called 'nobody'", 2),
        (("runs/fake", "--policy", "random"), "random is not the policy of runs/fake", 2),
        (("runs/fake", "--per-label", "0", "--output", "runs/fake"), "there is a folder of that name", 2),
        (("runs/fake", "--per-label", "-1"), "-1 is not in the range", 2),
    ],
)
def test_bad_input_is_refused_in_a_sentence(arguments: tuple[str, ...], sentence: str, code: int, run: Path) -> None:
    result = report(*arguments)
    assert result.exit_code == code
    assert sentence in result.stderr
    assert "Traceback" not in result.stderr
    assert not (run / "report.html").exists()


def test_a_damaged_run_is_a_mismatch(run: Path) -> None:
    (run / "results.parquet").write_bytes(b"not a table")
    result = report(str(run))
    assert result.exit_code == 6
    assert "results.parquet" in result.stderr and "evaluate the policy again" in result.stderr


@pytest.mark.parametrize("missing", ["PIL", "jinja2", "matplotlib"])
def test_without_the_extra_its_name_is_said(missing: str, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any, **named: Any) -> Any:
        if name.partition(".")[0] == missing:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name, *rest, **named)

    for name in ("evaluator.render.images", "evaluator.report.gallery", "evaluator.report.page"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setattr(builtins, "__import__", without)
    result = report(str(run))
    assert result.exit_code == 2
    assert 'pip install "rema[report]"' in result.stderr
