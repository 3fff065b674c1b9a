"""Fresh lists: the same for everybody with the seed, unlike anything else, and shown beside the clean rate."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from evaluator.cli.main import cli
from evaluator.leaderboard import leaderboard
from evaluator.leaderboard.fresh import FreshGap, fresh_counts
from evaluator.leaderboard.verification import known
from evaluator.run.reading import read_run
from evaluator.scenarios import load_list
from evaluator.scenarios.fresh import draw_fresh, picked_by_policy
from evaluator.scenarios.lists import VERSION, manifest_path, versions
from evaluator.scenarios.seeds import commitment, fresh_version
from evaluator.statistics import difference_interval
from rema_data.errors import InputError, IntegrityError
from rema_data.schema import TASKS
from tests.evaluator.fakes import InThisProcess
from tests.evaluator.runs import solved, use_installation, write_entry, write_run


def no_picker() -> Any:
    raise AssertionError("grasp needs no tools")


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))


def draw(seed: int, count: int = 30) -> str:
    return draw_fresh(seed, "grasp", count, InThisProcess, no_picker)


def test_a_seed_names_one_list(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = load_list("grasp", "test", draw(5))
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "elsewhere"))
    again = load_list("grasp", "test", draw(5))
    assert first == again and len(first.scenarios) == 30
    assert load_list("grasp", "test", draw(5, 10)).scenarios == first.scenarios[:10]
    assert versions()[0] == VERSION and versions()[-1].startswith("fresh-5-")


def test_no_scenario_is_one_of_another_list() -> None:
    known = {one.placements for split in ("test", "val") for one in load_list("grasp", split).scenarios}
    lists = [load_list("grasp", "test", draw(seed)).scenarios for seed in (0, 1, 2**63 - 1)]
    drawn = [one.placements for scenarios in lists for one in scenarios]
    assert len(set(drawn)) == 90 and not known & set(drawn)


def test_a_damaged_list_is_refused() -> None:
    version = draw(5)
    (file,) = manifest_path(version).parent.glob("*.parquet")
    file.write_bytes(file.read_bytes()[:-1] + b"x")
    with pytest.raises(IntegrityError):
        draw(5)


@pytest.mark.parametrize("seed", [-1, 2**63])
def test_a_number_that_is_no_seed(seed: int) -> None:
    with pytest.raises(InputError, match=f"seed {seed} is not"):
        fresh_version(seed, 10)


def test_tools_are_picked_as_in_the_clean_lists() -> None:
    assert [task for task in TASKS if picked_by_policy(task)] == ["grasp_grasp", "grasp_push"]


def test_commit_and_reveal() -> None:
    done = CliRunner().invoke(cli, ["fresh", "commit", "--seed", "77"])
    assert done.exit_code == 0 and commitment(77) in done.stdout
    assert CliRunner().invoke(cli, ["fresh", "reveal", "77", commitment(77)]).exit_code == 0
    other = CliRunner().invoke(cli, ["fresh", "reveal", "78", commitment(77)])
    assert other.exit_code != 0 and "is not the one" in other.stderr
    secret = [CliRunner().invoke(cli, ["fresh", "commit"]).stdout for _ in range(2)]
    assert secret[0] != secret[1]


def test_the_board_shows_clean_minus_fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use_installation(tmp_path, monkeypatch)
    version = draw(5, 200)
    runs = []
    for name, clean, fresh in (("honest", 0.7, 0.7), ("table", 0.95, 0.3)):
        runs.append(write_run(tmp_path / name, solved(clean, 1), policy=name))
        runs.append(write_run(tmp_path / f"{name}-fresh", solved(fresh, 2, 200), policy=name, suite=version))
    assert read_run(runs[1]).fresh and not read_run(runs[0]).fresh
    board = leaderboard(runs, published=False)
    found = {row.policy: row.fresh for row in board.rows}
    (alone,) = (text for text in leaderboard(runs[1:2], published=False).remarks if "is not shown" in text)
    assert alone.startswith("honest (grasp, conditional, fresh-") and "over which its policy was not played" in alone
    assert len(board.rows) == 2 and None not in found.values()
    honest, table = found["honest"], found["table"]
    assert honest is not None and honest[1] < 0 < honest[2]
    assert table is not None and table[0] == pytest.approx(0.65, abs=0.1) and table[1] > 0.5
    marked = [text for text in board.remarks if text.startswith("FRESH")]
    assert len(marked) == 1 and "table (grasp, conditional)" in marked[0]


def test_whole_fresh_lists_count_and_one_of_a_seed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use_installation(tmp_path, monkeypatch)
    clean = write_run(tmp_path / "clean", solved(0.7, 1))
    short, long, other = (
        write_run(tmp_path / version, solved(rate, 2, count), suite=version)
        for version, rate, count in ((draw(5, 50), 1.0, 50), (draw(5, 200), 0.5, 200), (draw(6, 100), 0.6, 100))
    )
    part = write_run(tmp_path / "part", solved(0.0, 2, 30), suite=draw(7, 60))

    def gap(*runs: Path) -> FreshGap | None:
        (row,) = leaderboard([clean, *runs], published=False).rows
        return row.fresh

    assert gap(short, long) == gap(long) == gap(long, part) and gap(part) is None
    both = fresh_counts([known(read_run(path)) for path in (long, other)])
    assert [count for _, count in both.values()] == [300]


def test_a_fall_is_adjusted_for_the_rows_of_the_board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use_installation(tmp_path, monkeypatch)
    version = draw(5, 200)
    runs = []
    for n in range(12):
        fresh = np.arange(200) < (100 if n else 78)
        runs.append(write_run(tmp_path / f"{n}", np.arange(300) < 150, policy=f"p{n}"))
        runs.append(write_run(tmp_path / f"{n}-fresh", fresh, policy=f"p{n}", suite=version))
    alone, many = (leaderboard(some, published=False) for some in (runs[:2], runs))
    assert [row.fresh.falls for row in alone.rows if row.fresh] == [True]
    assert not any(row.fresh.falls for row in many.rows if row.fresh)


def test_the_interval_of_a_difference() -> None:
    """Newcombe 1998, example (a) of method 10."""
    low, high = difference_interval(56, 70, 48, 80)
    assert (low, high) == (pytest.approx(0.0524, abs=1e-4), pytest.approx(0.3339, abs=1e-4))


def test_an_entry_that_was_not_simulated_here_counts_for_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A board over it is shown all the same: it has actions, and no counts yet."""
    use_installation(tmp_path, monkeypatch)
    clean = write_run(tmp_path / "clean", solved(0.7, 1))
    fresh = write_run(tmp_path / "fresh", solved(0.5, 2, 50), suite=draw(5, 50))
    entry = read_run(write_entry(tmp_path / "entry.json", fresh))
    assert not entry.has_counts and fresh_counts([entry]) == {}
    (row,) = leaderboard([clean, tmp_path / "entry.json"], published=False).rows
    assert row.rank == 1


def test_a_list_that_is_here_starts_no_process() -> None:
    version = draw(5)

    def no_pool() -> Any:
        raise AssertionError("nothing is drawn")

    assert draw_fresh(5, "grasp", 30, no_pool, no_picker) == version


def test_a_script_without_a_main_guard_is_told_what_it_lacks(tmp_path: Path) -> None:
    """Its processes import it, and would draw again."""
    (tmp_path / "script.py").write_text(
        "import evaluator\nevaluator.evaluate('random', task='grasp', fresh=3, episodes=4)"
    )
    done = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=100)
    assert done.returncode == 1
    assert 'call evaluate() below `if __name__ == "__main__":`' in done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["fresh", "commit"], 0, "seed (keep it secret): "),
        (
            ["evaluate", "random", "--task", "grasp", "--fresh", "3"],
            2,
            "simulation needs PyBullet, which is not installed",
        ),
    ],
)
def test_without_a_simulator_a_seed_can_be_committed_to(words: list[str], code: int, said: str) -> None:
    hidden = (
        "import sys, importlib.util as u; sys.modules['pybullet'] = None; there = u.find_spec; "
        "u.find_spec = lambda name, package=None: None if name == 'pybullet' else there(name, package); "
    )
    run = f"from evaluator.cli.main import cli; cli({words})"
    done = subprocess.run([sys.executable, "-c", hidden + run], capture_output=True, text=True, timeout=100)
    assert done.returncode == code and said in done.stdout + done.stderr
