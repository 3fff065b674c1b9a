"""The score of a suite: means of levels and axes, none where a scenario lacks, intervals over clean scenarios."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evaluator.run.cells import score
from evaluator.run.reading import read_run
from evaluator.statistics import clopper_pearson
from rema_data.errors import InputError
from rema_data.schema import Scenario
from tests.evaluator.runs import SUITE_AXES, SUITE_BASES, solved, use_installation, write_run, write_suite


@pytest.fixture
def suite(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Scenario]:
    use_installation(tmp_path, monkeypatch)
    return write_suite(tmp_path / "manifests")


def of_cell(suite: list[Scenario], axis: str, level: int) -> np.ndarray:
    return np.array([s.variation is not None and (s.variation.axis, s.variation.level) == (axis, level) for s in suite])


def test_hard_is_the_mean_of_axes_which_are_means_of_levels(suite: list[Scenario], tmp_path: Path) -> None:
    success = np.zeros(len(suite), bool)
    for axis, level in (("clutter", 1), ("clutter", 2), ("shape", 3), ("posts", 1), ("posts", 2), ("posts", 3)):
        success |= of_cell(suite, axis, level)
    found = score(read_run(write_run(tmp_path / "run", success, suite="tough-v1")))
    means = {axis.name: axis.mean for axis in found.axes}
    assert means == {"clutter": pytest.approx(2 / 3), "shape": pytest.approx(1 / 3), "posts": 1.0}
    assert found.hard == pytest.approx(0.5)  # posts are a track of their own
    assert found.worst is not None and found.worst.name == "shape"
    assert [cell.successes for cell in found.axes[0].cells] == [SUITE_BASES, SUITE_BASES, 0]
    assert found.interval == pytest.approx((0.5, 0.5))  # every clean scenario has the same levels solved


def test_levels_of_a_scenario_are_drawn_together(suite: list[Scenario], tmp_path: Path) -> None:
    """Half of the clean scenarios solved at every level: wider than if the levels were scenarios of their own."""
    success = np.array([s.variation is not None and s.variation.base % 2 == 0 for s in suite])
    found = score(read_run(write_run(tmp_path / "run", success, suite="tough-v1")))
    assert found.interval is not None and found.hard == pytest.approx(0.5)
    width = found.interval[1] - found.interval[0]
    assert width == pytest.approx(2 * 1.96 * (0.25 / SUITE_BASES / 2) ** 0.5, rel=0.1)


def test_no_mean_of_what_happens_to_be_there(suite: list[Scenario], tmp_path: Path) -> None:
    whole = np.ones(len(suite), bool)
    short = score(read_run(write_run(tmp_path / "short", whole[:50], suite="tough-v1")))
    assert short.hard is None and short.interval is None and all(axis.mean is None for axis in short.axes)
    assert sum(cell.measured for axis in short.axes for cell in axis.cells) == 50
    one = of_cell(suite, "shape", 2) & (np.arange(len(suite)) == np.flatnonzero(of_cell(suite, "shape", 2))[0])
    lost = score(read_run(write_run(tmp_path / "lost", whole, lost=one, suite="tough-v1")))
    assert {axis.name: axis.mean for axis in lost.axes} == {"clutter": 1.0, "shape": None, "posts": 1.0}
    assert lost.hard is None
    assert lost.lacking == [f"shape 2 ({SUITE_BASES - 1} of {SUITE_BASES})"]


def test_what_was_solved_everywhere_has_an_interval_nevertheless(suite: list[Scenario], tmp_path: Path) -> None:
    found = score(read_run(write_run(tmp_path / "run", np.ones(len(suite), bool), suite="tough-v1")))
    assert (
        found.hard == 1.0 and [axis.interval for axis in found.axes] == [clopper_pearson(SUITE_BASES, SUITE_BASES)] * 3
    )
    assert found.interval == clopper_pearson(2 * SUITE_BASES, 2 * SUITE_BASES)
    none = score(read_run(write_run(tmp_path / "none", np.zeros(len(suite), bool), suite="tough-v1")))
    assert none.interval == clopper_pearson(0, 2 * SUITE_BASES)


def test_a_run_over_clean_scenarios_has_no_score(suite: list[Scenario], tmp_path: Path) -> None:
    run = read_run(write_run(tmp_path / "run", solved(0.5, 1)))
    assert run.suite == ""
    with pytest.raises(InputError, match="not played over a suite"):
        score(run)


def test_the_fake_suite_has_what_it_says(suite: list[Scenario]) -> None:
    assert len(suite) == SUITE_BASES * sum(SUITE_AXES.values())
