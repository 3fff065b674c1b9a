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

from evaluator.run.proof import check_proof, make_proof
from evaluator.run.reading import read_run
from evaluator.run.run import Run
from evaluator.run.tables import to_parquet
from evaluator.scenarios import VERSION
from rema_data.errors import InputError, IntegrityError, MissingFileError

from .conftest import EPISODES, with_value

SEALED = ("results.parquet", "actions.bin", "leaves.bin", "summary.json", "run.json")
Copy = Callable[[str], Path]


def flip(path: Path, position: int, mask: int = 1) -> None:
    content = bytearray(path.read_bytes())
    content[position] ^= mask
    path.write_bytes(content)


def examined(run: Path) -> Run:
    return read_run(run, with_findings=True)


def places(run: Path, file: str) -> list[str]:
    return [finding.where for finding in examined(run).findings if finding.file == file]


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
    assert file in named


@pytest.mark.parametrize("file", SEALED)
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


def test_a_byte_of_the_leaves_names_the_row(copy_of: Copy) -> None:
    run = copy_of("short")
    flip(run / "leaves.bin", 32 * 40 + 5)
    assert places(run, "leaves.bin") == [f"row 40 ({VERSION}/grasp/test/00040)"]


@pytest.mark.parametrize(
    ("column", "value"), [("success", None), ("step0_lift_m", 1e-9), ("target_x_m", 0.5), ("step0_action", 33_000)]
)
def test_a_changed_value_names_the_row(copy_of: Copy, column: str, value: object) -> None:
    run = copy_of("short")
    table = pq.read_table(run / "results.parquet")
    (run / "results.parquet").write_bytes(to_parquet(with_value(table, column, 31, value)))
    found = places(run, "results.parquet")
    assert found[0] == f"row 31 ({VERSION}/grasp/test/00031)" and all(where.startswith("row 31 ") for where in found)
    assert places(run, "actions.bin") == []


def test_rows_that_are_gone_or_swapped(copy_of: Copy) -> None:
    run = copy_of("short")
    table = pq.read_table(run / "results.parquet")
    (run / "results.parquet").write_bytes(to_parquet(table.slice(0, EPISODES - 1)))
    assert any(f"has {EPISODES - 1} rows" in finding.detail for finding in examined(run).findings)
    order = [0, 2, 1, *range(3, EPISODES)]
    (run / "results.parquet").write_bytes(to_parquet(table.take(pa.array(order))))
    assert places(run, "results.parquet")[:2] == [
        f"row 1 ({VERSION}/grasp/test/00002)",
        f"row 2 ({VERSION}/grasp/test/00001)",
    ]


@pytest.mark.parametrize("part", ["identity", "policy", "segments"])
def test_a_changed_entry_of_the_header_is_named(copy_of: Copy, part: str) -> None:
    run = copy_of("short")
    text = (run / "run.json").read_text()
    old, new = {"identity": ('"d"', '"e"'), "policy": ('"fake"', '"real"'), "segments": ("shuffled", "shuffles")}[part]
    (run / "run.json").write_text(text.replace(old, new, 1))
    changed = examined(run)
    assert part in [finding.where for finding in changed.findings if finding.file == "run.json"]
    assert changed.seal_state == "changed"


def test_a_header_that_says_nothing_usable(copy_of: Copy) -> None:
    run = copy_of("short")
    header = json.loads((run / "run.json").read_text())
    header["identity"] = {"task": "fly"}
    (run / "run.json").write_text(json.dumps(header))
    with pytest.raises(IntegrityError, match="unknown task 'fly'.*protocol_hash is missing"):
        examined(run)


def test_one_episode_is_proved_without_the_run(home: Path) -> None:
    root = json.loads((home / "long" / "run.json").read_text())["seal"]["merkle_root"]
    proof = json.loads(json.dumps(make_proof(home / "long", 77)))
    assert len(proof["path"]) <= 7
    row = check_proof(proof, root)
    assert row["scenario"] == f"{VERSION}/grasp_grasp_push/test/00077"
    for other in ({**proof, "row": {**row, "success": not row["success"]}}, {**proof, "position": 76}):
        with pytest.raises(IntegrityError, match="not part of the run"):
            check_proof(other, root)
    for nothing in ([], {}, {**proof, "format": "x"}, {**proof, "path": ["zz"]}, 7):
        with pytest.raises(InputError, match="not the proof"):
            check_proof(nothing, root)


def test_no_proof_of_rows_that_were_changed(copy_of: Copy) -> None:
    run = copy_of("short")
    table = pq.read_table(run / "results.parquet")
    (run / "results.parquet").write_bytes(to_parquet(with_value(table, "success", 3, None)))
    with pytest.raises(IntegrityError, match="row 3"):
        make_proof(run, 5)
    with pytest.raises(InputError, match="has no episode 120"):
        make_proof(copy_of("long"), 120)
