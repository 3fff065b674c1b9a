"""What a user sees of a training."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from baselines.train.report import TrainingReport


class Loss:
    """As a tensor on a device: it can be added up for nothing, and reading it costs."""

    read = 0

    def __init__(self, value: float) -> None:
        self.value = value

    def __add__(self, other: Loss) -> Loss:
        return Loss(self.value + other.value)

    def __float__(self) -> float:
        Loss.read += 1
        return self.value


def test_the_loss_is_shown_and_seldom_read() -> None:
    told: list[str] = []
    notes: list[str] = []
    progress: Any = SimpleNamespace(
        phase=lambda *_: None, advance=lambda n: None, resume=lambda n: None, note=notes.append, tell=told.append
    )
    report = TrainingReport(progress, "train grasp", 100)
    report.resumed(10, [1, 2])
    assert "with 1 and 2 threads" in notes[0]
    for n in range(45):
        loss: Any = Loss(0.25 if n < 20 else 0.75)
        report.updated(loss, 8)
    assert [words.partition(",")[0] for words in told] == ["loss 0.250", "loss 0.750"]
    assert all(words.endswith("samples/s") for words in told) and Loss.read == 2
