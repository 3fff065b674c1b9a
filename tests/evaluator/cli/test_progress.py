"""What is written about progress where there is no terminal."""

from __future__ import annotations

import pytest

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
