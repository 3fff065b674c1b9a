"""Journals survive torn lines, compare what they are told twice, and make tables of fixed bytes."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from evaluator.engines import InfraError
from evaluator.run.records import Answered, Ledger, Simulated
from evaluator.run.tables import results_table, timings_table, to_parquet, verdict
from evaluator.scenarios import VERSION, load_list
from rema_data.errors import IntegrityError, StorageError
from rema_data.schema import Failure, StepOutcome

MISSED = StepOutcome(False, Failure.MISSED, arm="left", lift_m=0.1 + 0.2, peak_force_n=1e-17, sim_steps=120)
LIFTED = StepOutcome(True, None, arm="left", lift_m=0.3, peak_force_n=4.0, contact_steps=50, sim_steps=400)


def fill(folder: Path, indices: list[int], segment: int = 1) -> Ledger:
    ledger = Ledger(folder, segment)
    ledger.add_answers(Answered(index, 0, 33_000 + index) for index in indices)
    ledger.add_outcomes(Simulated(index, 0, LIFTED if index % 2 else MISSED, 0.1, "w0", 1) for index in indices)
    ledger.close()
    return ledger


def test_reopened_ledger_is_the_same(tmp_path: Path) -> None:
    written = fill(tmp_path, [0, 1, 2])
    read = Ledger(tmp_path, 2)
    assert {key: record.outcome for key, record in read.outcomes.items()} == {
        key: record.outcome for key, record in written.outcomes.items()
    }
    assert read.answers[0, 0].segment == 1


@pytest.mark.parametrize("cut", [1, 30, 90])
def test_torn_last_line_is_dropped(tmp_path: Path, cut: int) -> None:
    fill(tmp_path, [0, 1, 2])
    path = tmp_path / "outcomes-0001.jsonl"
    path.write_bytes(path.read_bytes()[:-cut])
    ledger = Ledger(tmp_path, 2)
    assert sorted(ledger.outcomes) == [(0, 0), (1, 0)]
    fill(tmp_path, [2], segment=2)
    assert len(Ledger(tmp_path, 3).outcomes) == 3


def test_damage_in_the_middle_is_an_error(tmp_path: Path) -> None:
    fill(tmp_path, [0, 1, 2])
    path = tmp_path / "outcomes-0001.jsonl"
    path.write_bytes(path.read_bytes().replace(b"{", b"#", 1))
    with pytest.raises(IntegrityError, match="line 1"):
        Ledger(tmp_path, 2)


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [("answers", b"33001", b"33002"), ("outcomes", b"0.3,", b"0.4,"), ("outcomes", b'"index"', b'"indem"')],
)
def test_a_changed_digit_is_an_error(tmp_path: Path, name: str, old: bytes, new: bytes) -> None:
    fill(tmp_path, [0, 1, 2])
    path = tmp_path / f"{name}-0001.jsonl"
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    with pytest.raises(IntegrityError, match=r"line \d is damaged"):
        Ledger(tmp_path, 2)


def test_an_outcome_counts_only_beside_the_answer_that_it_belongs_to(tmp_path: Path) -> None:
    """An answer whose line was deleted, because it was damaged, may differ when it is given again."""
    fill(tmp_path, [0, 1, 2])
    path = tmp_path / "answers-0001.jsonl"
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[1:]))
    (tmp_path / "answers-0001-backup.jsonl").write_text("of the user's")
    again = Ledger(tmp_path, 2)
    assert sorted(again.outcomes) == [(1, 0), (2, 0)]
    again.add_answers([Answered(0, 0, 41_000)])
    again.close()
    assert again.result(0, 0) is None and sorted(Ledger(tmp_path, 3).outcomes) == [(1, 0), (2, 0)]


def test_second_outcome_is_compared(tmp_path: Path) -> None:
    fill(tmp_path, [0])
    ledger = Ledger(tmp_path, 2)
    ledger.add_outcomes([Simulated(0, 0, MISSED, 9.9, "w1", 2)])
    assert ledger.contradictions == []
    ledger.add_outcomes([Simulated(0, 0, LIFTED, 9.9, "w1", 2)])
    assert ledger.contradictions == [(0, 0)]
    assert ledger.result(0, 0) == MISSED
    ledger.close()


def test_outcome_replaces_an_infrastructure_error(tmp_path: Path) -> None:
    ledger = Ledger(tmp_path, 1)
    ledger.add_outcomes([Simulated(0, 0, InfraError("died", "exit 1"), 9.9, "w1", 2)])
    assert verdict(0, (0,), ledger).infra_error == "died"
    ledger.close()
    again = Ledger(tmp_path, 2)
    again.add_outcomes([Simulated(0, 0, LIFTED, 0.1, "w1", 1)])
    again.close()
    assert Ledger(tmp_path, 3).result(0, 0) == LIFTED
    assert again.contradictions == []


def test_full_disk_is_a_storage_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ledger = Ledger(tmp_path, 1)

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(StorageError, match="no space"):
        ledger.add_outcomes([Simulated(1, 0, LIFTED, 0.1, "w0", 1)])


def test_tables(fake_home: Path) -> None:
    scenarios = load_list("grasp")
    fill(fake_home / "records", [2, 1, 0])
    ledger = Ledger(fake_home / "records", 2)
    ledger.add_answers([Answered(3, 0, None, "nan", "returned nan")])
    ledger.add_outcomes([Simulated(4, 0, InfraError("hung", "120 s"), 120.0, "w0", 2)])
    ledger.close()
    table = results_table(scenarios, 6, (0,), ledger)
    assert table.column("success").to_pylist() == [False, True, False, False, None, None]
    assert table.column("failure").to_pylist() == ["missed", None, "missed", "policy_error", None, None]
    assert table.column("infra_error").to_pylist() == [None, None, None, None, "hung", None]
    assert table.column("step0_action").to_pylist() == [33_000, 33_001, 33_002, None, None, None]
    assert table.column("step0_lift_m").to_pylist()[0] == 0.1 + 0.2
    assert table.column("step0_success").to_pylist()[3] is False
    assert table.column("scenario").to_pylist()[5] == f"{VERSION}/grasp/test/00005"

    other = Ledger(fake_home / "other", 7)
    other.add_outcomes([Simulated(4, 0, InfraError("hung", "other words"), 1.0, "w3", 2)])
    other.add_answers([Answered(3, 0, None, "nan", "x"), *(Answered(n, 0, 33_000 + n) for n in range(3))])
    other.add_outcomes(Simulated(n, 0, LIFTED if n % 2 else MISSED, 7.7, "w9", 2) for n in range(3))
    other.close()
    payload = to_parquet(results_table(scenarios, 6, (0,), other))
    assert payload == to_parquet(table)
    (fake_home / "t.parquet").write_bytes(payload)
    assert pq.read_table(fake_home / "t.parquet").equals(table)
    assert timings_table(other, 6).column("worker").to_pylist() == ["w9", "w9", "w9", "w3"]
