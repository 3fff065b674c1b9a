"""The figure of the data by round."""

from __future__ import annotations

import builtins
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from rema_data.errors import InputError, StorageError
from rema_data.schema import TASKS
from rema_data.statistics.count import Statistics, StepCount
from rema_data.statistics.plot import accumulated, plot_rounds


@st.composite
def last_steps(draw: st.DrawFn) -> Statistics:
    keys = draw(st.sets(st.tuples(st.integers(1, 4), st.sampled_from(list(TASKS)), st.sampled_from(["train", "val"]))))
    rows = []
    for number, task, split in sorted(keys):
        reached = draw(st.integers(0, 100))
        positives = draw(st.integers(0, reached))
        rows.append(StepCount(number, task, split, len(TASKS[task]) - 1, True, task, "random", reached, positives))
        rows.append(StepCount(number, task, split, 7, False, "grasp", "reference", 1000, 900))
    return Statistics("tiny", "0" * 64, tuple(rows), ())


@given(last_steps())
def test_sums_grow_to_the_totals(found: Statistics) -> None:
    sums = accumulated(found)
    assert list(sums) == [row.task for row in found.totals()]
    for total in found.totals():
        by_round = list(sums[total.task].values())
        assert by_round[-1] == (total.positives, total.negatives)
        for before, after in pairwise(by_round):
            assert before[0] <= after[0] and before[1] <= after[1]
    assert len({tuple(counts) for counts in sums.values()}) <= 1  # the same rounds for every task


FOUND = Statistics(
    "tiny",
    "0" * 64,
    (
        StepCount(1, "grasp", "train", 0, True, "grasp", "random", 100, 30),
        StepCount(2, "push", "train", 0, True, "push", "random", 100, 0),
    ),
    (),
)


def test_picture(tmp_path: Path) -> None:
    plot_rounds(FOUND, tmp_path / "a" / "rounds.png")
    with Image.open(tmp_path / "a" / "rounds.png") as picture:
        picture.load()
        assert picture.width > picture.height > 300
        colours = {colour for _, colour in picture.convert("RGB").getcolors(1 << 20) or []}
    assert {(0x1A, 0x7F, 0x37), (0xC9, 0xCC, 0xD1)} <= colours


def test_refusals(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a PNG"):
        plot_rounds(FOUND, tmp_path / "rounds.jpg")
    with pytest.raises(InputError, match="no block of tiny"):
        plot_rounds(Statistics("tiny", "", (), ()), tmp_path / "rounds.png")
    (tmp_path / "file").touch()
    with pytest.raises(StorageError):
        plot_rounds(FOUND, tmp_path / "file" / "rounds.png")


def test_without_matplotlib_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any, **named: Any) -> Any:
        if name.startswith("matplotlib"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match="matplotlib.*not installed") as caught:
        plot_rounds(FOUND, tmp_path / "rounds.png")
    assert caught.value.hint == 'pip install "rema[report]"'
