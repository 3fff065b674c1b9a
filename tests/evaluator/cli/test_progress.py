"""Progress on stderr, mostly where it is not a terminal."""

from __future__ import annotations

import io
import sys

import pytest
from rich.console import Console

from evaluator.cli import output
from evaluator.cli import progress as module
from evaluator.cli.progress import StderrProgress


def test_what_an_earlier_process_did_is_in_the_count_and_not_in_the_rate(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    seconds = iter(range(0, 100, 5))
    monkeypatch.setattr(module.time, "monotonic", lambda: float(next(seconds)))
    with StderrProgress() as progress:
        progress.phase("train", 100)
        progress.resume(80)
        progress.advance(20)
    assert "train: 100/100 in 10.0 s, 2.0/s" in capsys.readouterr().err


def test_the_state_of_a_phase_is_in_its_lines(capsys: pytest.CaptureFixture[str]) -> None:
    with StderrProgress() as progress:
        progress.phase("train", 4)
        progress.tell("loss 0.7")
        progress.advance(4)
        progress.tell("loss 0.5")
        progress.phase("collect", 2)
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith("train: 4/4") and first.endswith(", loss 0.5") and "loss" not in second


def test_on_a_terminal_it_is_beside_the_bar(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    terminal = Console(file=sys.stderr, force_terminal=True, width=120)
    monkeypatch.setattr(output, "console", lambda err: terminal)
    with StderrProgress() as progress:
        progress.phase("train", 4)
        progress.tell("loss 0.525")
        progress.advance(1)
    assert "loss 0.525" in capsys.readouterr().err


def test_a_result_is_on_stdout(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Even where the bars are on a terminal and stdout is a pipe; between bars where both are a terminal."""
    make = output.console
    with StderrProgress() as progress:
        progress.result("round 1: done")
    assert capsys.readouterr() == ("round 1: done\n", "")
    terminal = Console(file=sys.stderr, force_terminal=True, width=120)
    monkeypatch.setattr(output, "console", lambda err=False: terminal if err else make())
    with StderrProgress() as progress:
        progress.phase("train", 4)
        progress.result("round 2: done")
    assert capsys.readouterr().out == "round 2: done\n"
    monkeypatch.setattr(output, "console", lambda err=False: terminal)
    with StderrProgress() as progress:
        progress.phase("train", 4)
        progress.result("round 3: done")
    printed = capsys.readouterr()
    assert "round 3: done" in printed.err and printed.out == ""


def test_a_phase_in_bytes(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = iter(range(0, 100, 5))
    monkeypatch.setattr(module.time, "monotonic", lambda: float(next(seconds)))
    with StderrProgress(in_bytes=True) as progress:
        progress.phase("download", 30_000_000)
        progress.advance(20_000_000)
    assert "download: 20.0 MB/30.0 MB in 10.0 s, 2.0 MB/s" in capsys.readouterr().err


@pytest.mark.parametrize("width", [12, 24, 40, 60, 80])
def test_no_terminal_cuts_the_numbers(monkeypatch: pytest.MonkeyPatch, width: int) -> None:
    """A narrow one does without the bar, then without the other numbers: the count stays whole."""
    stream = io.StringIO()
    terminal = Console(file=stream, force_terminal=True, width=width, color_system=None, _environ={})
    monkeypatch.setattr(output, "console", lambda err=False: terminal)
    with StderrProgress() as progress:
        progress.phase("simulate again", 10_000)
        progress.advance(9_999)
        progress.tell("loss 0.5251")
    printed = stream.getvalue()
    assert "9999/10000" in printed and "\N{HORIZONTAL ELLIPSIS}" not in printed
    assert ("simulate again" in printed) == (width > 24) and ("loss" in printed) == ("loss 0.5251" in printed)
