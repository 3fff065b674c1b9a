"""The board of a suite: by ``hard``, beside the clean rate, and apart from the clean board."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from evaluator.cli.main import cli
from evaluator.leaderboard import leaderboard
from evaluator.leaderboard.comparison import compare
from evaluator.leaderboard.export import COLUMNS, cells
from evaluator.leaderboard.suite_tables import suite_tables
from evaluator.leaderboard.suites import BOARD_SUITE, suite_rows
from evaluator.leaderboard.verification import known
from evaluator.report.breakdown import breakdowns
from evaluator.run.reading import read_run
from evaluator.runner import run_evaluation
from evaluator.scenarios import load_list
from rema_data.errors import InputError
from tests.evaluator.fakes import fake_backend, fake_config
from tests.evaluator.runs import solved, use_installation, write_entry, write_run, write_suite

COUNT = 180
"""Scenarios of the fake suite."""


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Three policies over the clean list and over the suite."""
    use_installation(tmp_path, monkeypatch)
    write_suite(tmp_path / "manifests", BOARD_SUITE)
    made = []
    for name, clean, hard in (("good", 0.9, 0.8), ("same", 0.95, 0.78), ("poor", 0.6, 0.2)):
        made.append(write_run(tmp_path / name, solved(clean, len(name)), policy=name))
        made.append(write_run(tmp_path / f"{name}-hard", solved(hard, 7, COUNT), policy=name, suite="hard-v1"))
    return made


def test_policies_are_ranked_by_hard(runs: list[Path]) -> None:
    rows = leaderboard(runs, published=False).suites
    assert [row.policy for row in rows] == ["good", "same", "poor"]
    assert [row.rank for row in rows] == [1, 1, 3]
    assert rows[0].ties == rows[1].ties != rows[2].ties
    assert all(row.unranked == "" and row.suite == "hard-v1" for row in rows)
    assert rows[0].clean is not None and rows[0].score.hard is not None
    assert rows[0].retention == pytest.approx(rows[0].score.hard / rows[0].clean)


def test_the_clean_board_shows_hard_beside_the_rate_and_is_else_the_same(runs: list[Path]) -> None:
    clean, both = (leaderboard(some, published=False).rows for some in (runs[::2], runs))
    assert [row.policy for row in both] == ["same", "good", "poor"]
    assert [(row.policy, row.rank, row.ties, row.rate) for row in both] == [
        (row.policy, row.rank, row.ties, row.rate) for row in clean
    ]
    assert all(row.hard is None for row in clean)
    hard = {row.policy: row.score.hard for row in leaderboard(runs, published=False).suites}
    assert {row.policy: row.hard for row in both} == hard and None not in hard.values()


def test_an_entry_of_a_suite_is_a_row_of_its_board(runs: list[Path], tmp_path: Path) -> None:
    entry = write_entry(tmp_path / "entry.json", runs[1])
    (row,) = leaderboard([entry], published=False).suites
    assert row.score == leaderboard([runs[1]], published=False).suites[0].score and row.verified


def test_a_part_of_a_suite_has_no_rank(runs: list[Path], tmp_path: Path) -> None:
    part = write_run(tmp_path / "part", np.ones(50, bool), policy="part", suite="hard-v1")
    (row,) = (row for row in leaderboard([*runs, part], published=False).suites if row.policy == "part")
    assert row.rank is None and row.unranked == "50 of 180 scenarios" and row.score.hard is None
    shown = CliRunner().invoke(cli, ["leaderboard", str(part), "--no-entries", "--suite", "hard-v1"])
    assert (
        "part (grasp) has no rank: 50 of 180 scenarios (" in shown.stdout and f"{row.score.lacking[0]}" in shown.stdout
    )


def test_policies_that_were_trained_on_changed_situations_are_ranked_apart(runs: list[Path], tmp_path: Path) -> None:
    for name, seed in (("best", 11), ("nearly", 12)):
        write_run(tmp_path / name, solved(0.95, seed, COUNT), policy=name, suite="hard-v1", adapted=True)
    board = leaderboard([*runs, tmp_path / "best", tmp_path / "nearly"], published=False)
    alone = leaderboard(runs, published=False)
    assert [row for row in board.suites if not row.adapted] == list(alone.suites)
    assert {row.policy: row.rank for row in board.suites if row.adapted} == {"best": 1, "nearly": 1}
    clean, adapted = suite_tables(board, "hard-v1")
    assert (clean.title, adapted.title) == ("hard-v1: grasp", "hard-v1: grasp, adapted")
    assert [line[0] for line in clean.lines] == ["good", "same", "poor"] and len(adapted.lines) == 2


def test_the_clean_board_says_how_hard_was_reached(runs: list[Path], tmp_path: Path) -> None:
    made = [
        write_run(tmp_path / "mine", solved(0.9, 5), policy="mine", adapted=True),
        write_run(tmp_path / "mine-hard", solved(0.9, 6, COUNT), policy="mine", suite="hard-v1", adapted=True),
    ]
    board = leaderboard([*runs, *made], published=False)
    shown = {row.policy: dict(zip(COLUMNS, cells(row), strict=True))["hard %"] for row in board.rows}
    assert shown["mine"].endswith(" adapted") and float(shown["good"]) > 50


def test_another_name_with_the_same_digest_changes_no_row(runs: list[Path], tmp_path: Path) -> None:
    digest = read_run(runs[0]).provenance.policy_digest
    stranger = [
        write_run(tmp_path / "s-hard", solved(1.0, 1, COUNT), policy="stranger", digest=digest, suite=BOARD_SUITE),
        write_run(tmp_path / "s-blank", solved(1.0, 2), policy="stranger", digest=digest, protocol="blank-scene"),
    ]
    before, after = (leaderboard(some, published=False) for some in (runs, [*runs, *stranger]))
    assert before.rows == after.rows
    (row,) = (row for row in after.suites if row.policy == "stranger")
    assert row.clean is None and row.retention is None


def test_only_a_ranked_clean_run_stands_beside_a_row(runs: list[Path], tmp_path: Path) -> None:
    part = write_run(tmp_path / "part", np.ones(20, bool), policy="good")
    claim = write_run(tmp_path / "claim", solved(1.0, 9), policy="good", digest="", verified=False)
    assert leaderboard([*runs, part, claim], published=False).suites == leaderboard(runs, published=False).suites


def test_hard_is_that_of_the_suite_of_the_board(runs: list[Path], tmp_path: Path) -> None:
    write_suite(tmp_path / "manifests", "my-suite")
    easy = write_run(tmp_path / "easy", solved(1.0, 3, COUNT), policy="poor", suite="my-suite")
    before, after = (leaderboard(some, published=False) for some in (runs, [*runs, easy]))
    assert [row.hard for row in before.rows] == [row.hard for row in after.rows]
    assert len(after.suites) == len(before.suites) + 1


def test_a_suite_that_was_played_otherwise_has_no_rank(runs: list[Path], tmp_path: Path) -> None:
    other = write_run(tmp_path / "o", solved(1.0, 3, COUNT), policy="o", suite=BOARD_SUITE, protocol="blank-scene")
    (row,) = (row for row in leaderboard([*runs, other], published=False).suites if row.policy == "o")
    assert row.rank is None and row.unranked == "a suite is not played blank-scene"


def test_an_almost_copy_has_no_rank_in_a_suite(runs: list[Path]) -> None:
    run = known(read_run(runs[1]))
    actions = run.actions.copy()
    actions[:10] = actions[10:20]
    clone = dataclasses.replace(run, policy="clone", recorded=actions)
    rows = suite_rows([run, clone], {})
    assert {row.policy: row.unranked for row in rows} == {
        "good": "",
        "clone": "almost all of its actions are those of good",
    }


def test_a_lost_scenario_takes_the_rank_and_nothing_else(
    runs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("evaluator.leaderboard.eligibility.INFRA_LIMIT", 0.01)
    scenarios = load_list("grasp", "test", BOARD_SUITE).scenarios
    first = next(one.index for one in scenarios if one.variation is not None and one.variation.axis == "shape")
    lost = np.arange(COUNT) == first  # of an axis that counts in the mean
    run = write_run(tmp_path / "lossy", solved(0.9, 3, COUNT), lost=lost, policy="lossy", suite=BOARD_SUITE)
    rows = {row.policy: row for row in leaderboard([*runs, run], published=False).suites}
    assert rows["lossy"].rank is None and rows["lossy"].unranked == "scenarios that its mean needs have no result"
    assert rows["good"].rank == 1


def test_many_policies_can_still_differ(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use_installation(tmp_path, monkeypatch)
    write_suite(tmp_path / "manifests", BOARD_SUITE)
    made = [
        write_run(tmp_path / str(n), solved(0.04 * n, n, COUNT), policy=f"p{n}", suite=BOARD_SUITE) for n in range(25)
    ]
    ranks = {row.policy: row.rank for row in leaderboard(made, published=False).suites}
    assert ranks["p24"] == 1 and ranks["p0"] is not None and ranks["p0"] > 15


def test_the_table_by_axis(runs: list[Path]) -> None:
    (table,) = suite_tables(leaderboard(runs, published=False), "hard-v1")
    assert table.header[-3:] == ("clutter", "shape", "(posts)")
    assert [line[0] for line in table.lines] == ["good", "same", "poor"]
    with pytest.raises(InputError, match="no suite 'soft-v1'"):
        suite_tables(leaderboard(runs, published=False), "soft-v1")


@pytest.mark.parametrize("form", ["md", "csv", "json", None])
def test_from_the_command_line(runs: list[Path], form: str | None) -> None:
    options = ["--no-entries", "--no-published", "--suite", "hard-v1"]
    export = [] if form is None else ["--export", form]
    done = CliRunner().invoke(cli, ["leaderboard", *map(str, runs), *options, *export])
    assert done.exit_code == 0, done.output
    if form == "json":
        assert [row["policy"] for row in json.loads(done.stdout)["rows"]] == ["good", "same", "poor"]
    elif form == "csv":
        assert len(done.stdout.splitlines()) == 1 + 3 * 9
    else:
        assert "clutter" in done.stdout and "poor" in done.stdout


def test_the_pages_have_the_suite(runs: list[Path], tmp_path: Path) -> None:
    alone = write_run(tmp_path / "alone", solved(0.5, 4, COUNT), policy="alone", suite="hard-v1")
    arguments = ["leaderboard", *map(str, [*runs, alone]), "--no-entries", "--no-published"]
    done = CliRunner().invoke(cli, [*arguments, "--export", "site", "--output", str(tmp_path / "site")])
    assert done.exit_code == 0, done.output
    index = (tmp_path / "site" / "index.html").read_text()
    assert "<h2>hard-v1: grasp</h2>" in index and str(tmp_path) not in index
    for name in ("good", "alone"):
        (page,) = (tmp_path / "site" / "policies").glob(f"*-{name}.html")
        assert "hard-v1: grasp, clean-trained, hard" in page.read_text() and "level 3" in page.read_text()
    rows = json.loads((tmp_path / "site" / "hard-v1.json").read_text())["rows"]
    assert [row["policy"] for row in rows] == ["good", "same", "alone", "poor"]


def test_a_form_that_a_suite_has_not(runs: list[Path]) -> None:
    arguments = ["leaderboard", str(runs[1]), "--suite", "hard-v1", "--export", "tex"]
    done = CliRunner().invoke(cli, arguments)
    assert done.exit_code == 2 and "md, csv, json" in done.stderr


def test_a_run_knows_its_suite(runs: list[Path]) -> None:
    assert (read_run(runs[0]).suite, read_run(runs[1]).suite) == ("", "hard-v1")


def test_runs_are_compared_by_cell(runs: list[Path], tmp_path: Path) -> None:
    found = compare(read_run(runs[1]), read_run(runs[5]))
    cells = {row.label: row.table.n for row in found.strata if row.by == "cell"}
    assert cells == {f"{axis} {level}": 20 for axis in ("clutter", "shape", "posts") for level in (1, 2, 3)}
    with pytest.raises(InputError, match="scenarios_hash"):
        compare(read_run(runs[0]), read_run(runs[1]))
    entries = [write_entry(tmp_path / f"{n}.json", runs[n]) for n in (1, 5)]
    again = compare(*(known(read_run(entry)) for entry in entries))
    assert [(row.label, row.table) for row in again.strata] == [(row.label, row.table) for row in found.strata]


def test_a_report_has_the_cells(runs: list[Path]) -> None:
    titles = {one.title: len(one.groups) for one in breakdowns(read_run(runs[1]))}
    assert titles["cell of the suite: axis and level"] == 9


def test_a_report_has_a_map_of_axes_and_levels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use_installation(tmp_path, monkeypatch)
    write_suite(tmp_path / "manifests", BOARD_SUITE)
    page = tmp_path / "page.html"
    for version in ("hard-v1", None):
        config = fake_config(
            tmp_path / f"run-{version}", task="grasp", episodes=COUNT, engine="inline", version=version
        )
        run_evaluation(config, backend=fake_backend())
        arguments = ["report", str(config.output), "--per-label", "0", "--output", str(page)]
        done = CliRunner().invoke(cli, arguments)
        assert done.exit_code == 0, done.output
        text = page.read_text()
        assert ('id="suite"' in text) == ("clutter 3:" in text) == (version is not None)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--suite", "soft-v1"], "there is no suite 'soft-v1'"),
        (["--suite", "soft-v1", "--episodes", "5"], "there is no suite 'soft-v1'"),
        (["--suite", "v2", "--episodes", "5"], "there is no suite 'v2'"),
        (["--suite", "hard-v1", "--protocol", "end-to-end"], "has no end-to-end protocol"),
        (["--suite", "hard-v1", "--split", "val"], "has no val list of grasp"),
        (["--suite", "hard-v1", "--fresh", "3"], "a suite is frozen"),
        (["--suite", "hard-v1", "--episodes", "181"], "more than the 180 scenarios"),
        (["--fresh", "-3"], "the seed -3 is not in"),
        (["--fresh", "3", "--split", "val"], "a fresh list has no val split"),
    ],
)
def test_what_cannot_be_evaluated(runs: list[Path], options: list[str], words: str) -> None:
    done = CliRunner().invoke(cli, ["evaluate", "random", "--task", "grasp", *options])
    assert done.exit_code == 2 and words in done.stderr


def test_a_rate_of_zero_is_better_than_none(runs: list[Path], tmp_path: Path) -> None:
    part = write_run(tmp_path / "part", np.ones(50, bool), policy="part", suite="hard-v1")
    zero = write_run(tmp_path / "zero", np.zeros(COUNT, bool), policy="zero", suite="hard-v1")
    rows = leaderboard([part, *runs, zero], published=False).suites
    assert [row.policy for row in rows][-2:] == ["zero", "part"] and rows[-2].score.hard == 0
