"""What is known about a result: from a record that comes with rema, from this machine, or nothing."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluator.engines.base import load_attribute
from evaluator.leaderboard import copies, leaderboard
from evaluator.leaderboard.verification import known, read_verified, records, verify, write_record
from evaluator.protocol import protocol_hash
from evaluator.run.actions import NOT_ASKED, POLICY_ERROR, encode_actions
from evaluator.run.derived import Derived, derived_of
from evaluator.run.entry import encode, entry_folder, read_entry
from evaluator.run.reading import read_run
from evaluator.runner import run_evaluation
from rema_data import grid
from rema_data.errors import InputError, IntegrityError, RunMismatchError, SubmissionError
from tests.evaluator.fakes import FakePolicyProcess, fake_backend, fake_config
from tests.evaluator.runs import EPISODES, solved, use_installation, write_entry, write_run

TASK = "grasp_push"
WORLD = fake_backend(FakePolicyProcess(faulty=0.05), digest="d" * 64, protocol_hash=protocol_hash)


@pytest.fixture(autouse=True)
def _installation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use_installation(tmp_path, monkeypatch)
    monkeypatch.setattr("evaluator.rollout.derive.call_in_child", lambda target: load_attribute(target)())


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of an end-to-end run of the fake world, and of the cache of the machine that played it."""
    folder = tmp_path_factory.mktemp("played")
    with pytest.MonkeyPatch.context() as patch:
        use_installation(folder, patch)
        config = fake_config(
            folder / "run", TASK, protocol="end-to-end", episodes=EPISODES, engine="inline", audit_share=0.0
        )
        run_evaluation(config, backend=WORLD)
    return folder


@pytest.fixture
def run(played: Path, tmp_path: Path) -> Path:
    """A copy of the run, on the machine that played it."""
    shutil.copytree(played / "home" / "verified", tmp_path / "home" / "verified")
    return Path(shutil.copytree(played / "run", tmp_path / "run"))


@pytest.fixture
def entry(run: Path) -> Path:
    """Its entry, among those that come with the installation."""
    return write_entry(entry_folder() / "mine.json", run, policy="mine")


def forget() -> None:
    """As on another machine."""
    shutil.rmtree(Path(entry_folder().parents[1]) / "home" / "verified", ignore_errors=True)


def test_a_run_that_was_played_here_is_known_at_once(run: Path, entry: Path) -> None:
    assert known(read_run(run), WORLD).verified == known(read_entry(entry), WORLD).verified == "here"
    forget()
    assert known(read_run(run), WORLD).verified == known(read_entry(entry), WORLD).verified == ""
    assert verify(read_entry(entry), backend=WORLD, engine="inline").verified == "here"
    assert known(read_run(run), WORLD).verified == "here", "the same actions on the same list"


def test_an_entry_gives_the_counts_of_its_run(run: Path, entry: Path) -> None:
    forget()
    found, played = verify(read_entry(entry), backend=WORLD, engine="inline"), read_run(run)
    assert found.counts == played.counts and found.counts.policy_errors > 0
    assert np.array_equal(found.outcomes.success, played.outcomes.success)
    assert read_verified(run).counts == played.counts


def test_a_resumed_run_is_simulated_again(run: Path) -> None:
    """Journals of an earlier process may come from anywhere."""
    forget()
    config = fake_config(run, TASK, protocol="end-to-end", episodes=EPISODES, engine="inline", audit_share=0.0)
    run_evaluation(config, backend=WORLD)
    assert known(read_run(run), WORLD).verified == ""


def test_other_code_or_another_list_is_not_what_was_simulated(run: Path, entry: Path) -> None:
    other = dataclasses.replace(WORLD, observation_hash="changed")
    assert known(read_run(run), other).verified == known(read_entry(entry), other).verified == ""


def test_a_missing_answer_at_a_step_that_was_reached_is_a_failure(run: Path) -> None:
    played = read_run(run)
    actions = played.actions.copy()
    actions[:, 1] = NOT_ASKED
    path = write_entry(entry_folder() / "silent.json", run, recorded=actions, files=None, policy="silent")
    found = verify(read_entry(path), backend=WORLD, engine="inline")
    reached = played.counts.funnel[0].succeeded
    assert found.counts.successes == 0 and found.counts.eligible == EPISODES
    assert found.counts.policy_errors >= reached and found.counts.funnel[1].attempted == reached
    board = leaderboard([path], published=False, backend=WORLD)
    assert board.rows[0].unranked == f"{found.counts.policy_errors} of {EPISODES} episodes without a valid answer"


@pytest.mark.parametrize("action", [5, int(grid.encode(3, 30, 0)), int(grid.encode(30, 60, 15)), POLICY_ERROR - 20])
def test_an_action_outside_the_valid_grid_is_refused_by_name(run: Path, action: int) -> None:
    actions = read_run(run).actions.copy()
    actions[17, 0] = action
    path = write_entry(entry_folder() / "odd.json", run, recorded=actions, files=None, policy="odd")
    with pytest.raises(IntegrityError, match=f"action {action} in step 0 of scenario 17"):
        verify(read_entry(path), backend=WORLD, engine="inline")


def test_a_fresh_clone_shows_what_a_record_covers(entry: Path, run: Path) -> None:
    path = write_record(read_entry(entry), backend=WORLD, engine="inline")
    assert path == entry_folder() / "verified" / "mine.json"
    forget()
    found = known(read_entry(entry), WORLD)
    assert found.verified == "record" and found.counts == read_run(run).counts
    (row,) = leaderboard([entry], published=False, backend=WORLD).rows
    assert (row.rank, row.verified, row.successes) == (1, "record", found.counts.successes)
    before = path.read_bytes()
    assert write_record(read_entry(entry), backend=WORLD, engine="inline").read_bytes() == before


def test_without_a_record_an_entry_has_no_number(entry: Path) -> None:
    forget()
    (row,) = leaderboard([entry], published=False, backend=WORLD).rows
    assert (row.rank, row.rate, row.successes, row.verified) == (None, None, None, "")
    assert "not verified" in row.unranked


def spoiled(path: Path, **changes: Any) -> None:
    content = json.loads(path.read_text())
    for name, value in changes.items():
        part = content if name in content else content["rows"]
        part[name] = value
    path.write_text(json.dumps(content))


@pytest.mark.parametrize(
    "changes",
    [{"sha256": "0" * 64}, {"labels": ["", "success", "great"]}, {"codes": "AAAA"}, {"number": 0}, {"note": "hello"}],
)
def test_a_record_that_was_edited_is_refused(entry: Path, changes: dict[str, Any]) -> None:
    path = write_record(read_entry(entry), backend=WORLD, engine="inline")
    spoiled(path, **changes)
    with pytest.raises(IntegrityError):
        known(read_entry(entry), WORLD)


def test_a_record_with_other_rows_is_not_overwritten(entry: Path) -> None:
    path = write_record(read_entry(entry), backend=WORLD, engine="inline")
    rows = derived_of(read_run(entry.parents[2] / "run").table, (0, 1), {"pybullet": "0"})
    codes = rows.codes.copy()
    codes[codes == 2] = 1
    false = Derived(rows.steps, rows.labels, codes, rows.fingerprint)
    content = json.loads(path.read_text())
    path.write_text(json.dumps({**content, "rows": false.pack()}))
    with pytest.raises(IntegrityError, match="has other rows than"):
        write_record(read_entry(entry), backend=WORLD, engine="inline")


def test_a_record_is_of_one_entry_and_only_of_those_that_come_with_rema(entry: Path, run: Path, tmp_path: Path) -> None:
    write_record(read_entry(entry), backend=WORLD, engine="inline")
    assert records().keys() == {read_entry(entry).digest}
    outside = write_entry(tmp_path / "outside.json", run, policy="outside")
    for source in (read_entry(outside), read_run(run)):
        with pytest.raises(InputError, match="is not an entry of format 2 in"):
            write_record(source, backend=WORLD, engine="inline")
    taken = write_entry(entry_folder() / "random.json", run, policy="random", kind_of_policy="random")
    with pytest.raises(SubmissionError, match="name of an installed policy"):
        write_record(read_entry(taken), backend=WORLD, engine="inline")


def test_the_first_recorded_entry_is_the_original(entry: Path, run: Path) -> None:
    copy = write_entry(entry_folder() / "aaa.json", run, policy="aaa")
    for path in (entry, copy):
        write_record(read_entry(path), backend=WORLD, engine="inline")
    assert sorted(record.number for record in records().values()) == [1, 2]
    for order in ([entry, copy], [copy, entry], [run, copy, entry]):
        board = leaderboard(order, published=False, backend=WORLD)
        assert [row.policy for row in board.rows] == ["mine"]
        assert any("aaa" in remark and "is shown as that one" in remark for remark in board.remarks)


def test_what_nobody_can_verify(tmp_path: Path, run: Path) -> None:
    old = Path(__file__).resolve().parents[2] / "data" / "runs" / "entry-format-1.json"
    with pytest.raises(InputError, match="holds no actions"):
        verify(read_entry(old), backend=WORLD)
    other = dataclasses.replace(WORLD, protocol_hash=lambda task, name: "0" * 64)
    with pytest.raises(RunMismatchError, match="another protocol"):
        verify(read_run(run), backend=other, again=True)


def test_outcomes_that_actions_do_not_give_are_refused_by_name(tmp_path: Path) -> None:
    honest = write_run(tmp_path / "honest", solved(0.5, 1))
    false = write_run(tmp_path / "false", solved(0.9, 2), policy="my_policy", verified=False)
    assert encode_actions(read_run(honest).actions) == encode_actions(read_run(false).actions)
    with pytest.raises(IntegrityError, match=r"of its outcomes are not what its actions give: v2/grasp/test/\d{5}"):
        known(read_run(false))


def test_an_entry_that_was_simulated_here_is_recorded_at_once(entry: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    verify(read_entry(entry), backend=WORLD, engine="inline")
    monkeypatch.setattr("evaluator.leaderboard.verification.simulated", None)  # it would be called
    path = write_record(read_entry(entry), backend=WORLD, engine="inline")
    assert records()[read_entry(entry).digest].number == 1 and path.is_file()


def test_near_copies_are_shown_without_a_rank(run: Path, entry: Path) -> None:
    actions = read_run(run).actions.copy()
    actions[3, 0] = grid.encode(30, 30, 2)
    path = write_entry(entry_folder() / "near.json", run, recorded=actions, files=None, policy="near")
    for one in (entry, path):
        write_record(read_entry(one), backend=WORLD, engine="inline")
    board = leaderboard([path, entry], published=False, backend=WORLD)
    assert {row.policy: row.rank for row in board.rows} == {"mine": 1, "near": None}
    assert board.rows[-1].unranked == "almost all of its actions are those of mine"
    assert copies.COPY_SHARE == 0.9


def test_the_same_entry_has_the_same_bytes(run: Path) -> None:
    first = dataclasses.replace(read_run(run), kind_of_policy="submitted")
    assert encode(first) == encode(first)
