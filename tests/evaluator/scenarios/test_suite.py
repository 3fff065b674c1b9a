"""Drawing suites: cells, their order, their scenarios, and what makes them the same again."""

from __future__ import annotations

import json
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluator.scenarios import load_list
from evaluator.scenarios.axes import AXES
from evaluator.scenarios.drawn import work_folder
from evaluator.scenarios.generation import write_lists
from evaluator.scenarios.lists import versions
from evaluator.scenarios.suite import CELL, draw_suite, shuffled, vary
from evaluator.scenarios.suites import Cell, cells, cells_of, suite_length, suites
from evaluator.sim.observation import observation_sha256, observe
from evaluator.sim.simulator import Simulator
from rema_data.errors import InputError
from rema_data.schema import TASKS
from tests.evaluator.fakes import InThisProcess


def test_numbers_of_axes_are_their_own_and_leave_room_in_the_lists() -> None:
    numbers = [axis.number for axis in AXES.values()]
    assert sorted(numbers) == list(range(len(numbers)))
    for split, count in CELL.items():
        assert all(len(load_list(task, split).scenarios) >= len(numbers) * count for task in TASKS)


def test_every_cell_is_of_a_task_of_its_axis() -> None:
    for task in TASKS:
        found = cells(task)
        assert {cell.axis for cell in found} == {name for name, axis in AXES.items() if task in axis.tasks}
        assert len(set(found)) == len(found)


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator()


CELLS = [cell for task in ("grasp", "grasp_push") for cell in cells(task) if cell.level == 1]


@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: f"{cell.task}-{cell.axis}")
def test_a_scenario_of_a_cell(simulator: Simulator, cell: Cell) -> None:
    clean = load_list(cell.task, "val").scenarios[100 * AXES[cell.axis].number]
    made, again = (vary(simulator, clean, cell).scenario for _ in range(2))
    assert made == again and made != clean
    variation = made.variation
    assert variation is not None
    assert (variation.axis, variation.level, variation.base) == (cell.axis, 1, clean.index)
    seen, before = observe(made.last_situation()), observe(clean.last_situation())
    same = np.array_equal(seen.scene, before.scene) and np.array_equal(seen.depth, before.depth)
    assert same == (cell.axis in ("register", "act", "physics"))
    assert variation.seen == observation_sha256(seen)


def test_the_order_says_nothing_about_cells() -> None:
    order = shuffled(1000, "grasp", "test")
    assert sorted(order) == list(range(1000))
    assert abs(np.corrcoef(order, np.arange(1000))[0, 1]) < 0.1


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Two quick axes, and manifests that may be written to."""
    here = Path(__file__).parents[3] / "manifests" / "scenarios"
    (tmp_path / "scenarios").mkdir()
    for version in ("v1", "v2"):
        (tmp_path / "scenarios" / version).symlink_to(here / version)
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path))
    for module in ("suite", "suites"):
        monkeypatch.setattr(f"evaluator.scenarios.{module}.AXES", {name: AXES[name] for name in ("sense", "act")})
    return tmp_path


def test_a_suite_is_written_once_and_read_back(few: Path) -> None:
    manifest = draw_suite("tough-v1", InThisProcess(), ["push"], {"test": 3, "val": 2})
    written = {path.name: path.read_bytes() for path in manifest.parent.iterdir()}
    draw_suite("tough-v1", InThisProcess(), ["push"], {"test": 3, "val": 2})
    assert {path.name: path.read_bytes() for path in manifest.parent.iterdir()} == written
    listed = load_list("push", "test", "tough-v1")
    found = cells_of(listed)
    assert list(found) == [Cell("push", axis, level) for axis in ("sense", "act") for level in (1, 2, 3)]
    assert {len(rows) for rows in found.values()} == {3}
    assert suites() == ("tough-v1",) and versions()[0] == "v2"
    assert (suite_length("tough-v1", "push", "test"), suite_length("tough-v1", "push", "val")) == (18, 12)
    with pytest.raises(InputError, match="no test list of grasp"):
        suite_length("tough-v1", "grasp", "test")
    with pytest.raises(InputError, match="no suite 'soft-v1'"):
        suite_length("soft-v1", "grasp", "test")


@pytest.mark.parametrize("size", [{"test": 0, "val": 2}, {"test": 3, "val": -1}, {"test": 1112, "val": 2}])
def test_a_size_that_the_clean_lists_do_not_have(few: Path, size: dict[str, int]) -> None:
    """The clean scenarios of an axis begin where those of the axes before it end: the last one here is the ninth."""
    most = {"test": 10_000 // 9, "val": 2_000 // 9}
    assert max(AXES[cell.axis].number for cell in cells("push") if cell.axis in ("sense", "act")) == 8
    wrong = "val" if size["val"] < 1 else "test"
    with pytest.raises(InputError, match=f"of push/{wrong}: a cell has 1 to {most[wrong]}"):
        draw_suite("wrong", InThisProcess(), ["push"], size)
    assert "wrong" not in versions()
    with pytest.raises(KeyboardInterrupt):  # the largest size is drawn
        draw_suite("largest", _Interrupted(0), ["push"], most)


def test_workers_change_nothing(few: Path) -> None:
    with ProcessPoolExecutor(2) as pool:
        one = draw_suite("one", InThisProcess(), ["grasp"], {"val": 2})
        two = draw_suite("two", pool, ["grasp"], {"val": 2})
    assert (one.parent / "grasp_val.parquet").read_bytes() == (two.parent / "grasp_val.parquet").read_bytes()


def test_a_clean_list_has_no_cells() -> None:
    assert cells_of(load_list("grasp", "val")) == {}


class _Interrupted(InThisProcess):
    """Draws a few parts, and is then interrupted."""

    def __init__(self, parts: int) -> None:
        self.left, self.asked = parts, 0

    def map(self, function: Any, *jobs: Any, **_: Any) -> Any:
        for job in zip(*jobs, strict=True):
            if not self.left:
                raise KeyboardInterrupt
            self.left -= 1
            self.asked += 1
            yield function(*job)


def test_what_was_drawn_before_an_interruption_is_not_drawn_again(few: Path) -> None:
    whole = draw_suite("whole", InThisProcess(), ["grasp"], {"val": 2}, identity="code")
    with pytest.raises(KeyboardInterrupt):
        draw_suite("part", _Interrupted(4), ["grasp"], {"val": 2}, identity="code")
    work = work_folder(whole.parents[1] / "part" / "manifest.json", "grasp", "val")
    parts = sorted(work.rglob("*.parquet"))
    assert len(parts) == 4
    parts[0].write_bytes(parts[0].read_bytes()[:-1])  # damaged: drawn again
    rest = _Interrupted(100)
    made = draw_suite("part", rest, ["grasp"], {"val": 2}, identity="code")
    assert rest.asked == 6 - 3 and not work.exists()
    for name in ("grasp_val.parquet",):
        assert (made.parent / name).read_bytes() == (whole.parent / name).read_bytes()
    (made.parent / "grasp_val.parquet").unlink()  # the manifest still names it: drawn again, and the same
    draw_suite("part", InThisProcess(), ["grasp"], {"val": 2}, identity="other code")
    assert (made.parent / "grasp_val.parquet").read_bytes() == (whole.parent / "grasp_val.parquet").read_bytes()


def test_the_manifest_counts_what_was_drawn_again_by_cell(few: Path) -> None:
    manifest = draw_suite("counted", InThisProcess(), ["grasp"], {"val": 2})
    entry = json.loads(manifest.read_bytes())["lists"]["grasp/val"]
    assert set(entry["redrawn_by_cell"]) == {f"{axis} {level}" for axis in ("sense", "act") for level in (1, 2, 3)}
    assert sum(entry["redrawn_by_cell"].values()) == entry["redrawn"]


def test_a_suite_and_clean_lists_do_not_share_a_folder(few: Path) -> None:
    suite = draw_suite("tough", InThisProcess(), ["grasp"], {"val": 2})
    clean = write_lists("plain", InThisProcess(), ("push",), {"test": 2, "val": 2})
    before = suite.read_bytes(), clean.read_bytes()
    with pytest.raises(InputError, match="tough holds a suite") as caught:
        write_lists("tough", InThisProcess(), ("push",), {"test": 2, "val": 2})
    assert caught.value.hint.startswith("add --suite")
    with pytest.raises(InputError, match="plain holds clean lists") as caught:
        draw_suite("plain", InThisProcess(), ["grasp"], {"val": 2})
    assert caught.value.hint.startswith("drop --suite")
    assert (suite.read_bytes(), clean.read_bytes()) == before
