"""Runs and entries of every format stay readable: the code of its time wrote each one in ``tests/data/runs``."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from evaluator.leaderboard import leaderboard
from evaluator.replay import replay
from evaluator.report import ReportOptions, write_report
from evaluator.run import tables
from evaluator.run.entry import FORMAT as ENTRY_FORMAT
from evaluator.run.entry import encode, find_entries, read_entry, seal
from evaluator.run.header import RUN_FORMAT
from evaluator.run.reading import read_run
from evaluator.runner import run_evaluation
from rema_data.errors import IntegrityError
from rema_data.schema import Evidence
from tests.evaluator.fakes import FakePolicyProcess, fake_backend, fake_config

DATA = Path(__file__).resolve().parents[2] / "data" / "runs"
ENTRY, NEWER_ENTRY = (DATA / f"entry-format-{number}.json" for number in range(1, ENTRY_FORMAT + 1))
FORMATS = range(1, RUN_FORMAT + 1)


@pytest.fixture
def installation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The scenario list of the runs: its bytes, which they name by their hash, depend on the version of pyarrow."""
    shutil.copytree(DATA / "manifests", tmp_path / "manifests")
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    return tmp_path


@pytest.fixture
def newer_schema(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a later version does that measures one thing more."""
    work = ("work_j", "float | None", dataclasses.field(default=None, metadata={"since": 2}))
    newer = dataclasses.make_dataclass("Evidence", [work], bases=(Evidence,), kw_only=True, frozen=True)
    monkeypatch.setattr(tables, "Evidence", newer)
    monkeypatch.setattr(tables, "_STEP_FIELDS", (*tables._STEP_FIELDS, ("work_j", pa.float64())))


def copy_of(number: int, to: Path) -> Path:
    return shutil.copytree(DATA / f"format-{number}", to / f"format-{number}")


def evaluate_again(run: Path) -> int:
    """The command that made the runs; how many questions the policy was asked."""
    process = FakePolicyProcess(faulty=0.05)
    fields: dict[str, Any] = {"protocol": "end-to-end", "episodes": 12, "engine": "inline", "audit_share": 0.5}
    run_evaluation(fake_config(run, "grasp_push", **fields), backend=fake_backend(process))
    return process.asked


@pytest.mark.parametrize("number", FORMATS)
def test_every_format_of_a_run_is_read(number: int) -> None:
    run = read_run(DATA / f"format-{number}")
    assert run.seal_state == "whole" and run.kind == "run"
    assert (run.counts.successes, run.counts.eligible, run.counts.policy_errors) == (7, 12, 1)
    assert [(step.attempted, step.succeeded) for step in run.counts.funnel] == [(12, 9), (9, 7)]
    assert int(run.outcomes.success.sum()) == 7 and len(run.targets.shape) == len(run.rows) == 12
    assert run.audit is not None and (run.audit.actions, run.audit.outcome_flips) == (21, 0)
    assert len(run.faults()) == 1 and len(run.timings) == 20


@pytest.mark.parametrize("number", FORMATS)
@pytest.mark.usefixtures("newer_schema")
def test_a_later_version_with_one_more_column_reads_them(number: int, installation: Path) -> None:
    run = read_run(DATA / f"format-{number}", with_findings=True)
    assert run.findings == () and run.counts.successes == 7
    assert {row["step1_work_j"] for row in run.rows} == {None}
    report = replay(run.source, engine="inline", backend=fake_backend())
    assert report.ok and report.replayed == 12
    page = write_report(run.source, installation / "page.html", ReportOptions(per_label=0)).path.read_text()
    assert "7 of 12 eligible" in page


def test_a_column_that_is_not_new_may_not_be_missing(tmp_path: Path) -> None:
    folder = copy_of(1, tmp_path)
    header = json.loads((folder / "run.json").read_text())
    del header["seal"]
    (folder / "run.json").write_text(json.dumps(header))
    assert read_run(folder).seal_state == "unsealed"
    table = pq.read_table(folder / "episodes.parquet")
    pq.write_table(table.drop_columns(["step1_lift_m"]), folder / "episodes.parquet")
    with pytest.raises(IntegrityError, match=r"episodes\.parquet lacks step1_lift_m"):
        read_run(folder)
    pq.write_table(table.append_column("magic", table["success"]), folder / "episodes.parquet")
    with pytest.raises(IntegrityError, match=r"episodes\.parquet has an unknown column magic"):
        read_run(folder)


@pytest.mark.parametrize("number", [1, 2])
@pytest.mark.parametrize("file", ["results", "actions.bin", "summary.json", "run.json"])
def test_the_seals_of_earlier_formats_are_checked(tmp_path: Path, number: int, file: str) -> None:
    folder = copy_of(number, tmp_path)
    (folder / "leaves.bin").unlink()  # of which the seal knows, and nobody asks any more
    assert read_run(folder).seal_state == "whole"
    name = {"results": "episodes.parquet" if number == 1 else "results.parquet"}.get(file, file)
    content = bytearray((folder / name).read_bytes())
    place = content.index(b'"nondeterministic": 0') + 20 if name == "summary.json" else len(content) // 2
    content[place] ^= 1
    (folder / name).write_bytes(content)
    with pytest.raises(IntegrityError, match=name.replace(".", r"\.")):
        read_run(folder)


def test_a_run_of_format_1_goes_on_and_is_of_the_newest_format_then(tmp_path: Path, installation: Path) -> None:
    folder = copy_of(1, tmp_path)
    before = pq.read_table(folder / "episodes.parquet")
    assert evaluate_again(folder) == 0
    assert pq.read_table(folder / "results.parquet").equals(before) and not (folder / "episodes.parquet").exists()
    assert json.loads((folder / "run.json").read_text())["format"] == RUN_FORMAT
    assert read_run(folder, with_findings=True).seal_state == "whole"


def test_the_newest_format_is_what_is_written(installation: Path) -> None:
    evaluate_again(installation / "run")
    newest = DATA / f"format-{RUN_FORMAT}"
    assert {path.name for path in newest.iterdir()} == {path.name for path in (installation / "run").iterdir()} - {
        ".lock"
    }
    written, known = (pq.read_table(path / "results.parquet") for path in (installation / "run", newest))
    assert written.equals(known, check_metadata=True)
    mine, kept = (json.loads((path / "run.json").read_text()) for path in (installation / "run", newest))
    assert mine["format"] == kept["format"] and mine.keys() == kept.keys() and mine["end"].keys() == kept["end"].keys()
    ours, theirs = (json.loads((path / "summary.json").read_text()) for path in (installation / "run", newest))
    assert ours.keys() == theirs.keys(), "an optional field was added: keep a run of it in tests/data/runs"


def test_entries_of_format_1_are_read_and_stand_apart() -> None:
    entry = read_run(ENTRY)
    assert (entry.policy, entry.link, entry.counts.eligible) == ("my_policy", "https://example.org", 300)
    for path in find_entries():
        assert read_entry(path).seal_state == "whole"
    (row,) = leaderboard([ENTRY], published=False).rows
    assert (row.policy, row.rank, row.verified) == ("my_policy", None, "") and row.rate and row.unranked


@pytest.mark.usefixtures("installation")
def test_entries_of_the_newest_format_are_read_and_written_unchanged() -> None:
    entry = read_run(NEWER_ENTRY)
    assert (entry.policy, entry.link, entry.actions.shape) == ("my_policy", "https://example.org", (300, 2))
    assert json.loads(encode(entry)) == json.loads(NEWER_ENTRY.read_bytes())


def newer_run(folder: Path) -> Path:
    header = json.loads((folder / "run.json").read_text())
    header["segments"][-1]["versions"]["rema"] = "0.9.1"
    (folder / "run.json").write_text(json.dumps({**header, "format": RUN_FORMAT + 1, "novelty": True}))
    return folder


def newer_entry(folder: Path) -> Path:
    content = json.loads(ENTRY.read_text())
    content.update(format=ENTRY_FORMAT + 1, novelty=True)
    content["provenance"]["rema"] = "0.9.1"
    path = folder / "entry.json"
    path.write_text(json.dumps({**content, "sha256": seal(content)}))
    return path


@pytest.mark.parametrize("make", [newer_run, newer_entry])
def test_a_newer_format_is_refused_with_the_version_to_install(make: Callable[[Path], Path], tmp_path: Path) -> None:
    path = make(copy_of(1, tmp_path))
    with pytest.raises(IntegrityError, match=r"has format \d; this version of rema reads formats up to") as caught:
        read_run(path)
    assert 'pip install --upgrade "rema>=0.9.1"' in caught.value.hint


@pytest.mark.parametrize(
    "damage",
    [
        lambda header: header.update(format="1"),
        lambda header: header.update(segments=3),
        lambda header: header["segments"].append([]),
        lambda header: header["segments"][0].update(versions=["rema"]),
        lambda header: header["segments"][0].update(seconds={"total": "long"}),
        lambda header: header["identity"].pop("task"),
        lambda header: header["identity"].update(protocol="open"),
        lambda header: header["policy"].update(privileged="no"),
        lambda header: header.update(episodes=-1),
        lambda header: header.update(seal=[]),
        lambda header: header["seal"].update(files=[1]),
        lambda header: header["seal"].update(steps=["0"]),
        lambda header: header.update(seal="no sha256"),
        lambda header: header["seal"].pop("sha256"),
        lambda header: header["seal"]["files"].update({"../other": "0"}),
    ],
)
def test_no_header_gives_a_traceback(damage: Callable[[dict[str, Any]], None], tmp_path: Path) -> None:
    folder = copy_of(1, tmp_path)
    header = json.loads((folder / "run.json").read_text())
    damage(header)
    (folder / "run.json").write_text(json.dumps(header, indent=2) + "\n")
    with pytest.raises(IntegrityError) as caught:
        read_run(folder)
    assert "run.json" in caught.value.message and caught.value.hint
