"""A changed byte is found, and named: which file, and which row."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluator.replay import replay
from evaluator.run.reading import read_run
from evaluator.run.run import Run
from evaluator.run.tables import to_parquet
from evaluator.scenarios import VERSION
from rema_data.errors import IntegrityError, MissingFileError
from tests.evaluator.fakes import fake_backend

from .conftest import EPISODES, with_value

SEALED = ("results.parquet", "actions.bin", "run.json")
DERIVED = "summary.json"
Copy = Callable[[str], Path]


def flip(path: Path, position: int, mask: int = 1) -> None:
    content = bytearray(path.read_bytes())
    content[position] ^= mask
    path.write_bytes(content)


def examined(run: Path) -> Run:
    return read_run(run, with_findings=True)


def places(run: Path, file: str) -> list[str]:
    return [finding.where for finding in examined(run).findings if file in finding.file]


@pytest.mark.parametrize("name", ["short", "long"])
def test_an_untouched_run_has_no_findings(home: Path, name: str) -> None:
    run = examined(home / name)
    assert run.findings == () and run.seal_state == read_run(home / name).seal_state == "whole"
    assert run.folder.actions is not None and run.table is not None and run.summary is not None


@pytest.mark.parametrize("file", SEALED)
@given(where=st.floats(0, 1, exclude_max=True), mask=st.integers(1, 255))
@settings(max_examples=40, deadline=None)
def test_any_changed_byte_of_a_sealed_file_is_found(
    home: Path, tmp_path_factory: pytest.TempPathFactory, file: str, where: float, mask: int
) -> None:
    run = shutil.copytree(home / "long", tmp_path_factory.mktemp("run") / "long")
    flip(run / file, int(where * (run / file).stat().st_size), mask)
    try:
        named = {finding.file for finding in examined(run).findings}
    except IntegrityError as error:
        named = {"run.json"} if "run.json" in error.message else set()
    assert any(file in name for name in named)


def test_every_number_of_the_summary_is_compared(copy_of: Copy) -> None:
    """It is not sealed, as it follows from what is: but for the last bits of a fraction, any other value is found."""
    run = copy_of("long")
    summary = json.loads((run / DERIVED).read_text())
    for name, value in summary.items():
        other = value + 1 if type(value) in (int, float) else {"x": 1} if value is None else [value]
        (run / DERIVED).write_text(json.dumps({**summary, name: other}, indent=2) + "\n")
        assert places(run, DERIVED), name
    (run / DERIVED).write_text(json.dumps({**summary, "novelty": 1}, indent=2) + "\n")
    assert places(run, DERIVED) == ["novelty"]


@pytest.mark.parametrize("file", [*SEALED, DERIVED])
def test_a_file_cut_short_or_gone(copy_of: Copy, file: str) -> None:
    run = copy_of("short")
    content = (run / file).read_bytes()
    (run / file).write_bytes(content[: len(content) // 2])
    if file == "run.json":
        with pytest.raises(IntegrityError, match=r"run\.json"):
            examined(run)
    else:
        assert places(run, file)
    (run / file).unlink()
    if file == "run.json":
        with pytest.raises(MissingFileError, match="holds no run"):
            examined(run)
    else:
        assert any("is missing" in finding.detail for finding in examined(run).findings if finding.file == file)


def test_a_byte_of_the_action_log_names_episode_and_step(copy_of: Copy) -> None:
    run = copy_of("long")
    flip(run / "actions.bin", 2 * (4 * 17 + 0))
    (finding,) = examined(run).findings
    assert (finding.file, finding.where) == ("actions.bin", f"row 17 ({VERSION}/grasp_grasp_push/test/00017), step 0")
    assert "results.parquet says action" in finding.detail


@pytest.mark.parametrize(("column", "value"), [("step0_lift_m", 1e-9), ("target_x_m", 0.5), ("step0_action", 33_000)])
def test_a_changed_value_is_found_and_a_replay_names_the_row(copy_of: Copy, column: str, value: object) -> None:
    run = copy_of("short")
    table = pq.read_table(run / "results.parquet")
    (run / "results.parquet").write_bytes(to_parquet(with_value(table, column, 31, value)))
    with pytest.raises(IntegrityError, match=r"results\.parquet"):
        read_run(run)
    found = replay(run, engine="inline", backend=fake_backend()).findings
    assert {finding.where.partition(" (")[0] for finding in found} - {""} == {"row 31"}
    assert not any(finding.file == "actions.bin" for finding in found)


def test_a_success_that_is_gone_is_found(copy_of: Copy) -> None:
    run = copy_of("short")
    table = pq.read_table(run / "results.parquet")
    (run / "results.parquet").write_bytes(to_parquet(with_value(table, "success", 31, None)))
    assert places(run, "results.parquet") and places(run, "summary.json")


def test_rows_that_are_gone_or_swapped(copy_of: Copy) -> None:
    run = copy_of("short")
    table = pq.read_table(run / "results.parquet")
    (run / "results.parquet").write_bytes(to_parquet(table.slice(0, EPISODES - 1)))
    assert any(f"has {EPISODES - 1} rows" in finding.detail for finding in examined(run).findings)
    order = [0, 2, 1, *range(3, EPISODES)]
    (run / "results.parquet").write_bytes(to_parquet(table.take(pa.array(order))))
    assert any("not have one row for every scenario" in finding.detail for finding in examined(run).findings)


@pytest.mark.parametrize(("old", "new"), [('"d"', '"e"'), ('"fake"', '"real"'), ("shuffled", "shuffles")])
def test_a_changed_header_is_found(copy_of: Copy, old: str, new: str) -> None:
    run = copy_of("short")
    text = (run / "run.json").read_text()
    (run / "run.json").write_text(text.replace(old, new, 1))
    changed = examined(run)
    assert any("run.json" in finding.file for finding in changed.findings) and changed.seal_state == "changed"


def test_a_header_that_says_nothing_usable(copy_of: Copy) -> None:
    run = copy_of("short")
    header = json.loads((run / "run.json").read_text())
    header["identity"] = {"task": "fly"}
    (run / "run.json").write_text(json.dumps(header))
    with pytest.raises(IntegrityError, match="unknown task 'fly'.*protocol_hash is missing"):
        examined(run)
