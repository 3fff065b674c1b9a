"""Runs that are missing, unfinished or damaged: one clear sentence each, and no page."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from evaluator.report import write_report
from evaluator.run.reading import read_run
from rema_data.errors import InputError, IntegrityError, MissingFileError, RemaError
from tests.evaluator.runs import reseal

Copy = Callable[..., Path]


def test_a_run_is_read_whole(push_run: Path) -> None:
    run = read_run(push_run)
    assert len(run.rows) == run.summary["episodes"] == len(run.measured)
    assert run.tag == "privileged" and run.steps == (0,) and not run.end_to_end
    assert {fault["reason"] for fault in run.faults()} == {"exception"}
    assert len(run.faults()) == run.counts.policy_errors > 0


def test_what_is_not_there(copied_run: Copy, tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="no finished run"):
        write_report(tmp_path / "nowhere")
    folder = copied_run()
    for name in ("timings.parquet", "results.parquet", "run.json", "summary.json"):
        (folder / name).unlink()
        with pytest.raises(MissingFileError) as caught:
            write_report(folder)
        assert str(folder) in caught.value.message and caught.value.hint
    assert not list(folder.glob("*.html"))


@pytest.mark.parametrize("name", ["results.parquet", "timings.parquet", "run.json", "summary.json"])
@pytest.mark.parametrize("content", [b"", b"{}", b"PAR1 rubbish PAR1", b'"text"'])
def test_damaged_files(name: str, content: bytes, copied_run: Copy) -> None:
    folder = copied_run()
    (folder / name).write_bytes(content)
    with pytest.raises(RemaError) as caught:
        write_report(folder)
    assert isinstance(caught.value, IntegrityError | InputError)
    assert name in caught.value.message and caught.value.hint
    assert not list(folder.glob("*.html"))


@pytest.mark.parametrize("field", ["successes", "eligible", "infra_errors"])
def test_a_summary_that_the_table_contradicts(field: str, copied_run: Copy, push_run: Path) -> None:
    before = json.loads((push_run / "summary.json").read_text())[field]
    change = -1 if field == "successes" else 1
    with pytest.raises(IntegrityError, match=field):
        write_report(copied_run(**{field: before + change}))


@pytest.mark.parametrize("field", ["seconds", "ci95", "fingerprint", "scenarios_hash"])
def test_a_summary_without_a_field(field: str, push_run: Path, tmp_path: Path) -> None:
    """Even where somebody sealed it again."""
    folder = shutil.copytree(push_run, tmp_path / "run")
    with pytest.raises((InputError, IntegrityError), match=f"summary.json.*{field} (is|says) 7"):
        write_report(reseal(folder, **{field: 7}))
    summary = json.loads((folder / "summary.json").read_text())
    del summary[field]
    (folder / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(IntegrityError, match=f"summary.json.*{field} (is missing|says null)"):
        write_report(folder)


def test_a_table_without_a_column(copied_run: Copy) -> None:
    folder = copied_run()
    table = pq.read_table(folder / "results.parquet")
    pq.write_table(table.drop_columns(["step0_lift_m"]), folder / "results.parquet")
    with pytest.raises(IntegrityError, match=r"results.parquet lacks step0_lift_m"):
        write_report(folder)


def test_timings_of_other_types(copied_run: Copy) -> None:
    """No seal is over them."""
    folder = copied_run()
    table = pq.read_table(folder / "timings.parquet")
    pq.write_table(table.set_column(2, "seconds", pa.nulls(table.num_rows, pa.float64())), folder / "timings.parquet")
    with pytest.raises(IntegrityError, match=r"timings.parquet cannot be read"):
        write_report(folder)
