"""Two runs on the same scenarios."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from evaluator.leaderboard.comparison import compare
from evaluator.leaderboard.verification import read_verified as read_run
from evaluator.statistics import detectable_difference, midp_mcnemar, pair_table, paired_interval
from rema_data.errors import InputError, IntegrityError, MissingFileError
from tests.evaluator.runs import (
    EPISODES,
    FINGERPRINT,
    STOPPED,
    solved,
    use_installation,
    write_entry,
    write_manifests,
    write_run,
)

A, B = solved(0.6, 1), solved(0.5, 2)

OLD_ENTRY = Path(__file__).resolve().parents[2] / "data" / "runs" / "entry-format-1.json"


@pytest.fixture(autouse=True)
def _manifests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use_installation(tmp_path, monkeypatch)


@pytest.fixture
def a(tmp_path: Path) -> Path:
    return write_run(tmp_path / "a", A)


@pytest.fixture
def b(tmp_path: Path) -> Path:
    return write_run(tmp_path / "b", B, policy="other")


def test_everything_follows_from_the_pairs(a: Path, b: Path) -> None:
    found = compare(read_run(a), read_run(b))
    table = pair_table(A, B)
    assert found.table == table and found.interval == paired_interval(table) and found.p == midp_mcnemar(table)
    assert found.detectable == detectable_difference(EPISODES, table.discordance)
    assert found.only_a == tuple(np.flatnonzero(A & ~B)) and found.only_b == tuple(np.flatnonzero(B & ~A))
    assert found.remarks == ()
    content = found.to_dict()
    assert content["discordant"]["only_a"] == list(found.only_a)
    assert content["a"]["successes"] == A.sum() and content["rate_b"] == pytest.approx(B.mean())


def test_strata_split_all_scenarios_and_carry_their_numbers(a: Path, b: Path) -> None:
    found = compare(read_run(a), read_run(b))
    for by in ("shape", "length", "yaw"):
        tables = [row.table for row in found.strata if row.by == by]
        assert sum(table.n for table in tables) == EPISODES
        assert sum(table.only_a for table in tables) == found.table.only_a
    shapes = [row.label for row in found.strata if row.by == "shape"]
    assert shapes == ["I", "L", "T"]
    assert all(row.p_adjusted >= midp_mcnemar(row.table) - 1e-12 for row in found.strata)


def test_entries_compare_like_their_runs(tmp_path: Path, a: Path, b: Path) -> None:
    paths = []
    for folder in (a, b):
        paths.append(tmp_path / f"{folder.name}.json")
        write_entry(paths[-1], folder)
    whole, packed = compare(read_run(a), read_run(b)), compare(*map(read_run, paths))
    mixed = compare(read_run(a), read_run(paths[1]))
    for found in (packed, mixed):
        assert found.table == whole.table and found.only_a == whole.only_a
        assert [(row.by, row.label, row.table) for row in found.strata] == [
            (row.by, row.label, row.table) for row in whole.strata
        ]


def test_old_entries_are_compared_and_say_that_nobody_can_verify_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_manifests(tmp_path / "elsewhere", tasks=("grasp_push",))
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "elsewhere"))
    found = compare(read_run(OLD_ENTRY), read_run(OLD_ENTRY))
    assert found.strata == () and any("No breakdown" in remark for remark in found.remarks)
    assert any(remark.startswith("NOT VERIFIED") for remark in found.remarks)


def test_entries_of_a_list_that_is_not_here_are_refused(
    tmp_path: Path, a: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_entry(tmp_path / "a.json", a)
    write_manifests(tmp_path / "elsewhere", tasks=("grasp_push",))
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "elsewhere"))
    with pytest.raises(IntegrityError, match="its scenario list .* is not here"):
        read_run(path)


@pytest.mark.parametrize(
    ("field", "changes"),
    [
        ("task", {"task": "grasp_push"}),
        ("split", {"split": "val"}),
        ("protocol", {"protocol": "end-to-end"}),
        ("protocol_hash", {"identity": {"protocol_hash": "7" * 64}}),
        ("scenarios_hash", {"identity": {"scenarios_hash": "8" * 64}}),
    ],
)
def test_runs_that_do_not_compare_are_refused(tmp_path: Path, a: Path, field: str, changes: dict[str, object]) -> None:
    other = read_run(write_run(tmp_path / "b", B, **changes))  # type: ignore[arg-type]
    with pytest.raises(InputError) as caught:
        compare(read_run(a), other)
    assert caught.value.facts["field"] == field
    assert f"{field} is {caught.value.facts['a']} in" in caught.value.message
    assert str(caught.value.facts["b"]) in caught.value.message


def test_another_simulator_is_said_loudly(tmp_path: Path, a: Path) -> None:
    other = write_run(tmp_path / "b", B, identity={"fingerprint": {"pybullet": "3.2.8", "probe": "c" * 64}})
    (remark,) = compare(read_run(a), read_run(other)).remarks
    assert remark.startswith("ANOTHER SIMULATOR") and "pybullet 3.2.7 and 3.2.8" in remark


def test_another_build_that_gives_the_same_bits_is_the_same_simulator(tmp_path: Path, a: Path) -> None:
    other = write_run(tmp_path / "b", B, identity={"fingerprint": {**FINGERPRINT, "pybullet": "pybullet-arm64-3.2.8"}})
    assert compare(read_run(a), read_run(other)).remarks == compare(read_run(a), read_run(a)).remarks


def test_a_shorter_run_is_compared_where_it_can_be(tmp_path: Path, a: Path) -> None:
    short = write_run(tmp_path / "b", B[:90], policy="other", stopped_early=STOPPED)
    found = compare(read_run(a), read_run(short))
    assert found.table == pair_table(A[:90], B[:90])
    assert sum(row.table.n for row in found.strata if row.by == "shape") == 90
    assert any("only the 90 scenarios" in remark for remark in found.remarks)
    assert any("stopped early" in remark for remark in found.remarks)


def test_scenarios_that_a_shard_did_not_play_are_left_out(tmp_path: Path, a: Path) -> None:
    """The rows of a machine that does a part of a run: the others have no result."""
    part = np.arange(EPISODES) < 90
    folder = write_run(tmp_path / "b", B, unplayed=~part)
    found = compare(read_run(a), read_run(folder))
    assert found.table == pair_table(A, B, part)
    assert found.only_a == tuple(np.flatnonzero(A & ~B & part))
    assert [remark.partition(":")[0] for remark in found.remarks] == ["210 scenarios are left out", str(folder)]
    both = compare(read_run(folder), read_run(folder))
    assert both.table.n == part.sum() == sum(row.table.n for row in both.strata if row.by == "shape")


def test_lost_episodes_are_left_out_and_named(tmp_path: Path, a: Path) -> None:
    lost = np.zeros(EPISODES, bool)
    lost[[3, 40, 41]] = True
    other = write_run(tmp_path / "b", B, lost=lost)
    found = compare(read_run(a), read_run(other))
    assert found.table == pair_table(A, B, ~lost)
    assert not {3, 40, 41} & {*found.only_a, *found.only_b}
    assert any(remark.startswith("3 scenarios are left out") for remark in found.remarks)


def test_a_run_that_was_stopped_is_no_fair_sample(tmp_path: Path, a: Path) -> None:
    other = write_run(tmp_path / "b", B, unplayed=np.arange(EPISODES) < 12)
    found = compare(read_run(a), read_run(other))
    assert any("12 of its episodes were not finished" in remark for remark in found.remarks)


@pytest.mark.parametrize(
    ("changes", "kind", "message"),
    [
        ({"eligible": float("inf")}, IntegrityError, "eligible says Infinity, results.parquet gives 300"),
        ({"fingerprint": "abc"}, IntegrityError, 'fingerprint says "abc", run.json gives {'),
        ({"nondeterministic": "0"}, IntegrityError, "run.json is not a run header: end.nondeterministic is '0'"),
        ({"audit": {"actions": 1}}, IntegrityError, "run.json is not a run header: end.audit.action_flips is missing"),
    ],
)
def test_a_summary_of_something_else_is_refused(
    tmp_path: Path, changes: dict[str, object], kind: type[Exception], message: str
) -> None:
    with pytest.raises(kind, match=re.escape(message)):
        read_run(write_run(tmp_path / "b", B, **changes))


def test_a_table_of_other_types_is_refused(b: Path) -> None:
    table = pq.read_table(b / "results.parquet")
    place = table.column_names.index("success")
    texts = pa.array([str(value) for value in table["success"].to_pylist()])
    pq.write_table(table.set_column(place, "success", texts), b / "results.parquet")
    with pytest.raises(IntegrityError, match="column success is string, not bool"):
        read_run(b)


def test_a_run_without_its_table_cannot_be_compared(a: Path, b: Path) -> None:
    (b / "results.parquet").unlink()
    with pytest.raises(MissingFileError, match=r"results\.parquet does not exist"):
        compare(read_run(a), read_run(b))
