"""The board: who has a rank, who ties with whom, and what is said about the rest."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluator.leaderboard import Board, Row, leaderboard, published_rows
from evaluator.leaderboard.export import titled_groups
from evaluator.leaderboard.ranking import LEVEL
from evaluator.run.header import RUN_FILE
from evaluator.statistics import holm, midp_mcnemar, pair_table
from rema_data.errors import IntegrityError, MissingFileError
from tests.evaluator.runs import (
    AUDIT,
    EPISODES,
    FINGERPRINT,
    STOPPED,
    Bools,
    reseal,
    solved,
    use_installation,
    write_entry,
    write_run,
)

Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """``write(name, success, ...)`` writes a run of the policy ``name``, beside manifests with short lists."""
    use_installation(tmp_path, monkeypatch)

    def run(name: str, success: Any, **changes: Any) -> Path:
        return write_run(tmp_path / "runs" / name, success, **{"policy": name, **changes})

    return run


def rows(board: Board) -> dict[str, Row]:
    """Rows of the board by policy, but for the paper's."""
    return {row.policy: row for row in board.rows if row.tag != "published"}


def remark(board: Board, word: str) -> str:
    return next((text for text in board.remarks if word in text), "")


def test_the_published_rows_are_the_papers() -> None:
    rates = {(row.policy, row.task): row.rate for row in published_rows()}
    assert len(rates) == 16
    assert rates["scripted", "push"] == pytest.approx(0.9987)
    assert rates["random", "grasp_grasp"] == pytest.approx(0.0177)
    assert rates["joint", "grasp_push"] == pytest.approx(0.4549)
    intervals = {(row.policy, row.task): row.ci95 for row in published_rows()}
    assert intervals["joint", "grasp"] == pytest.approx((0.9303, 0.9400), abs=1e-4)  # as the paper's counts would give


def test_letters_are_those_of_the_adjusted_paired_tests(write: Write) -> None:
    outcomes: dict[str, Bools] = {"good": solved(0.9, 1), "same": solved(0.88, 2), "fair": solved(0.6, 3)}
    outcomes["poor"] = solved(0.2, 4)
    board = leaderboard([write(name, success) for name, success in outcomes.items()], published=False)
    pairs = list(combinations(outcomes, 2))
    adjusted = holm([midp_mcnemar(pair_table(outcomes[a], outcomes[b])) for a, b in pairs])
    found = rows(board)
    for (a, b), p in zip(pairs, adjusted, strict=True):
        assert bool(set(found[a].ties) & set(found[b].ties)) == (p > LEVEL)
    assert [row.policy for row in board.rows] == sorted(outcomes, key=lambda name: -outcomes[name].sum())
    assert [found[name].rank for name in ("good", "same", "fair", "poor")] == [1, 1, 3, 4]
    assert "the 6 pairs of the board" in remark(board, "ties")


def test_the_family_spans_all_tasks(write: Write) -> None:
    """A difference that is beyond chance alone is not beyond chance among many."""
    a = solved(0.5, 1)
    b = a.copy()
    b[np.flatnonzero(~b)[:6]] = True  # six discordant pairs on one side: p = 1 / 64
    alone = leaderboard([write("a", a), write("b", b)], published=False)
    assert set(rows(alone)["a"].ties) != set(rows(alone)["b"].ties)
    others = [write(f"other{n}", solved(0.5, 10 + n), task="grasp_push") for n in range(4)]
    sources = [Path(row.source) for row in alone.rows]
    together = leaderboard([*sources, *others], published=False)
    assert rows(together)["a"].ties == rows(together)["b"].ties == "a"


def test_privileged_rows_have_letters_but_neither_take_nor_give_a_rank(write: Write) -> None:
    board = leaderboard(
        [
            write("scripted", solved(0.95, 1)),
            write("mine", solved(0.5, 2)),
            write("cheat", solved(0.9, 3), privileged=True),
        ]
    )
    found = rows(board)
    assert [found[name].tag for name in ("scripted", "cheat", "mine")] == ["privileged", "privileged", "submitted"]
    assert (found["mine"].rank, found["scripted"].rank, found["cheat"].rank) == (1, None, None)
    assert found["mine"].ties != found["scripted"].ties and "ground truth" in remark(board, "privileged")


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"split": "val"}, "val split"),
        ({"stopped_early": STOPPED}, "stopped early"),
        ({"identity": {"scenarios_hash": "0" * 64}}, "another scenario list"),
        ({"identity": {"protocol_hash": "0" * 64}}, "another protocol version"),
        ({"unplayed": np.arange(EPISODES) < 5}, "5 episodes not finished"),
        ({"nondeterministic": 1}, "steps with two outcomes"),
        ({"audit": {**AUDIT, "outcome_flips": 2}}, "2 of 30 repeated outcomes flipped"),
        ({"audit": {**AUDIT, "action_flips": 9}}, "9 of 30 repeated answers differed"),
        ({"audit": None}, "never repeated"),
    ],
)
def test_runs_without_a_rank_are_shown_and_say_why(write: Write, changes: dict[str, Any], reason: str) -> None:
    board = leaderboard([write("mine", solved(0.5, 1)), write("odd", solved(0.99, 2), **changes)], published=False)
    odd = rows(board)["odd"]
    assert (odd.rank, odd.ties, odd.unranked) == (None, "", reason)
    assert rows(board)["mine"].rank == 1 and board.rows[-1] is odd
    assert reason in remark(board, "odd")


def test_short_runs_have_no_rank(write: Write) -> None:
    board = leaderboard([write("short", solved(0.5, 1, 40)), write("mine", solved(0.5, 1))])
    assert rows(board)["short"].unranked == f"40 of {EPISODES} scenarios"


def test_a_summary_alone_is_not_a_run(write: Write) -> None:
    folder = write("mine", solved(0.5, 1))
    (folder / "results.parquet").unlink()
    with pytest.raises(MissingFileError, match=r"results\.parquet does not exist"):
        leaderboard([folder])


def test_an_edited_summary_of_a_sealed_run_is_refused(write: Write) -> None:
    folder, other = write("mine", solved(0.5, 1)), write("other", solved(0.4, 2))
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps({**summary, "nondeterministic": 0, "isolation": "L3"}))
    board = leaderboard([folder, other], published=False)
    assert [row.policy for row in board.rows] == ["other"]
    (error,) = board.refused
    assert error.exit_code == 6 and 'summary.json isolation says "L3", run.json gives null' in error.message


def test_a_run_whose_seal_was_taken_away_is_refused(write: Write) -> None:
    folder = write("mine", solved(0.5, 1))
    header = json.loads((folder / "run.json").read_text())
    del header["seal"]
    (folder / "run.json").write_text(json.dumps(header, indent=2) + "\n")
    with pytest.raises(MissingFileError, match="is not sealed"):
        leaderboard([folder], published=False)


def test_a_copy_that_has_no_rank_takes_no_place(write: Write) -> None:
    mine = write("mine", solved(0.5, 2))
    copy = Path(shutil.copytree(mine, mine.with_name("aaa")))
    header = json.loads((copy / RUN_FILE).read_text())
    header["policy"]["name"] = "aaa"  # before the original by name
    (copy / RUN_FILE).write_text(json.dumps(header))
    reseal(copy, stopped_early=STOPPED)
    (row,) = leaderboard([copy, mine], published=False).rows
    assert (row.policy, row.rank) == ("mine", 1)


def test_a_rank_that_hangs_on_lost_episodes_is_none(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    """Six discordant pairs decide; three lost episodes could undo them, and do no harm where the gap is wide."""
    monkeypatch.setattr("evaluator.leaderboard.eligibility.INFRA_LIMIT", 0.05)
    a = solved(0.5, 1)
    close = a.copy()
    close[np.flatnonzero(~close)[:6]] = True
    lost = np.zeros(EPISODES, bool)
    lost[np.flatnonzero(a & close)[:3]] = True
    board = leaderboard([write("a", a), write("close", close, lost=lost)], published=False)
    assert "lost to the infrastructure" in rows(board)["close"].unranked and rows(board)["a"].rank == 1
    assert rows(board)["close"].bounds == pytest.approx(((close.sum() - 3) / EPISODES, close.sum() / EPISODES))
    wide = leaderboard([Path(rows(board)["a"].source), write("wide", solved(0.9, 5), lost=lost)], published=False)
    assert rows(wide)["wide"].rank == 1 and rows(wide)["wide"].ties == "a"


def test_what_nobody_simulated_stands_apart(write: Write) -> None:
    mine, claimed = write("mine", solved(0.5, 1)), write("claimed", solved(0.99, 2), verified=False)
    board = leaderboard([claimed, mine], published=False)
    assert [(row.policy, row.rank, bool(row.verified)) for row in board.rows] == [
        ("mine", 1, True),
        ("claimed", None, False),
    ]
    assert rows(board)["claimed"].unranked.startswith("not verified") and remark(board, "NOT VERIFIED")
    titles = [title for title, _ in titled_groups(board)]
    assert len(titles) == 2 and titles[1].startswith("grasp, conditional: not verified")
    assert not remark(leaderboard([mine]), "NOT VERIFIED")


def test_a_policy_that_carries_the_simulator_has_letters_and_no_rank(write: Write, tmp_path: Path) -> None:
    entry = write_entry(tmp_path / "oracle.json", write("oracle", solved(0.99, 1)), kind_of_policy="simulator")
    said = write("said", solved(0.9, 3), simulator=True)  # by the class of the policy
    board = leaderboard([entry, write("mine", solved(0.5, 2)), said], published=False)
    found = rows(board)
    assert (found["said"].tag, found["said"].rank) == ("simulator", None)
    assert (found["oracle"].tag, found["oracle"].rank, found["mine"].rank) == ("simulator", None, 1)
    assert found["oracle"].ties != found["mine"].ties and remark(board, "simulator: it carries")


@pytest.mark.parametrize("name", ["random", "scripted"])
def test_a_run_under_the_name_of_an_installed_policy_must_be_of_it(write: Write, name: str) -> None:
    own, taken = write(name, solved(0.5, 1)), write(f"{name}-2", solved(0.6, 2), policy=name, digest="f" * 64)
    board = leaderboard([own, taken], published=False)
    verdicts = {row.source: row.unranked for row in board.rows}
    assert not verdicts[str(own)] and "is the name of an installed policy" in verdicts[str(taken)]


def test_two_policies_of_one_name_are_said_to_be_two(write: Write) -> None:
    sources = [write("mine", solved(0.5, 1)), write("other", solved(0.6, 2), policy="mine", digest="e" * 64)]
    board = leaderboard(sources, published=False)
    assert remark(board, "2 rows of grasp (conditional) are called mine") and len(board.rows) == 2


def test_another_simulator_is_said_loudly(write: Write) -> None:
    sources = [
        write("a", solved(0.5, 1)),
        write("b", solved(0.6, 2), identity={"fingerprint": {"pybullet": "3.2.8"}}),
    ]
    board = leaderboard(sources)
    assert remark(board, "ANOTHER SIMULATOR") and all(row.rank for row in rows(board).values())
    assert not remark(leaderboard(sources[:1]), "ANOTHER SIMULATOR")
    build = {"fingerprint": {**FINGERPRINT, "pybullet": "pybullet-arm64-3.2.8"}}
    same_bits = write("c", solved(0.4, 3), identity=build)
    assert not remark(leaderboard([sources[0], same_bits]), "ANOTHER SIMULATOR")


def test_the_end_to_end_rate_stands_beside_the_conditional_one(write: Write) -> None:
    first, last = solved(0.8, 1), solved(0.5, 2)
    sources = [
        write("mine", last, task="grasp_push"),
        write("mine-whole", [first, last], task="grasp_push", protocol="end-to-end", policy="mine"),
    ]
    board = leaderboard(sources, published=False)
    by_protocol = {row.protocol: row for row in board.rows}
    assert by_protocol["conditional"].end_to_end == pytest.approx((first & last).mean())
    assert by_protocol["end-to-end"].end_to_end is None
    steps = [(step.attempted, step.succeeded) for step in by_protocol["end-to-end"].funnel]
    assert steps == [(EPISODES, first.sum()), (first.sum(), (first & last).sum())]


def test_only_the_papers_own_policies_have_a_distance_to_it(write: Write) -> None:
    board = leaderboard([write(name, solved(0.5, 1)) for name in ("random", "tae-joint", "joint", "mine")])
    assert {name for name, row in rows(board).items() if row.z is not None} == {"random", "tae-joint"}
    assert "scenes and its simulator are not" in remark(board, "published")
    whole = leaderboard([write("scripted", solved(0.5, 1), task="grasp", protocol="end-to-end")])
    assert rows(whole)["scripted"].z is None


def test_a_run_and_its_entry_are_one_row(write: Write, tmp_path: Path) -> None:
    folder = write("mine", solved(0.5, 1))
    path = tmp_path / "entry.json"
    write_entry(path, folder, policy="renamed", link="https://example.org")
    board = leaderboard([folder, path], published=False)
    assert [(row.policy, row.link) for row in board.rows] == [("mine", "")]
    twin = write("twin", solved(0.5, 1), digest="f" * 64)
    assert len(leaderboard([folder, path, twin], published=False).rows) == 2


def test_no_episode_no_rate(write: Write) -> None:
    nothing = np.ones(20, bool)
    row = rows(leaderboard([write("mine", nothing, lost=nothing)]))["mine"]
    assert row.rate is None and row.ci95 is None and row.bounds == (0.0, 1.0) and row.unranked


def test_an_empty_board_has_the_papers_rows() -> None:
    assert {row.tag for row in leaderboard([]).rows} == {"published"}
    assert leaderboard([], published=False) == Board((), ())


def test_a_source_that_cannot_be_read_is_left_out_and_named(write: Write) -> None:
    good, damaged, unfinished = (write(name, solved(0.5, 1)) for name in ("good", "damaged", "unfinished"))
    (damaged / "results.parquet").write_bytes(b"nothing")
    (unfinished / "summary.json").unlink()
    board = leaderboard([damaged, good, unfinished], published=False)
    assert [row.policy for row in board.rows] == ["good"]
    assert [type(error) for error in board.refused] == [IntegrityError, MissingFileError]
    assert len([text for text in board.remarks if text.startswith("LEFT OUT")]) == 2
    with pytest.raises(IntegrityError, match="damaged"):
        leaderboard([damaged, unfinished])


def test_the_sandbox_of_a_policy_is_shown(write: Write) -> None:
    board = leaderboard([write("mine", solved(0.5, 1), isolation="L2")], published=False)
    assert rows(board)["mine"].isolation == "L2"
