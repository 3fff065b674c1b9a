"""What a run must be to become an entry, one condition at a time."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from evaluator.leaderboard.submission import check_run, make_entry
from evaluator.run.entry import encode, read_entry
from evaluator.run.header import RUN_FILE, encode_header
from evaluator.run.merkle import merkle_root
from evaluator.run.rows import row_leaves
from evaluator.run.seal import EPISODES_FILE, LEAVES_FILE, make_seal
from evaluator.run.tables import to_parquet
from rema_data.errors import InputError, MissingFileError, SubmissionError
from tests.evaluator.runs import AUDIT, EPISODES, solved, write_manifests, write_run


@pytest.fixture(autouse=True)
def _manifests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_manifests(tmp_path / "manifests")
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))


def failed(folder: Path) -> list[str]:
    """Conditions that a run does not meet; submitting it says the same."""
    names = [check.what for check in check_run(folder) if not check.passed]
    if names:
        with pytest.raises(SubmissionError) as caught:
            make_entry(folder)
        assert caught.value.facts["failed"] == names and caught.value.exit_code == 3
        assert all(name in caught.value.message for name in names)
    return names


def reseal(folder: Path, root: bytes = b"", **identity: Any) -> None:
    """Seal a changed folder anew, as somebody who edits files on purpose would."""
    header = json.loads((folder / RUN_FILE).read_text())
    header["identity"].update(identity)
    seal = header.pop("seal")
    files = {name: (folder / name).read_bytes() for name in seal["files"]}
    root = root or bytes.fromhex(seal["merkle_root"])
    header["seal"] = make_seal(header, files, root=root, steps=seal["steps"], unfinished=0)
    (folder / RUN_FILE).write_text(encode_header(header))


@pytest.mark.parametrize("protocol", ["conditional", "end-to-end"])
def test_a_whole_run_becomes_an_entry(tmp_path: Path, protocol: str) -> None:
    passed = [solved(0.8, 1), solved(0.5, 2)] if protocol == "end-to-end" else solved(0.5, 2)
    folder = write_run(tmp_path / "run", passed, task="grasp_push", protocol=protocol)
    assert failed(folder) == []
    entry = make_entry(folder, link="https://example.org")
    assert encode(entry) == encode(make_entry(folder, link="https://example.org"))
    path = tmp_path / "entry.json"
    path.write_bytes(encode(entry))
    found = read_entry(path).run
    summary = json.loads((folder / "summary.json").read_text())
    assert (found.counts.successes, found.counts.eligible) == (summary["successes"], EPISODES)
    assert [(step.attempted, step.succeeded) for step in found.counts.funnel] == [
        (step["attempted"], step["succeeded"]) for step in summary["funnel"]
    ]


@pytest.mark.parametrize(
    ("changes", "condition"),
    [
        ({"stopped_early": True}, "stopped_early"),
        ({"unfinished": 1}, "unfinished"),
        ({"nondeterministic": 2}, "nondeterministic"),
        ({"audit": None}, "audit"),
        ({"audit": {**AUDIT, "outcome_flips": 1}}, "audit"),
        ({"audit": {**AUDIT, "action_flips": 2}}, "actions"),  # of 30: over 5 %
        ({"identity": {"protocol_hash": "0" * 64}}, "protocol_hash"),
        ({"identity": {"scenarios_hash": "0" * 64}}, "scenarios_hash"),
        ({"identity": {"policy_digest": "none"}}, "run.json policy_digest"),
        ({"identity": {"fingerprint": {}}}, "summary.json fingerprint"),
        ({"policy_digest": "0" * 64}, "summary.json policy_digest"),
        ({"success_rate": 0.9}, "summary.json success_rate"),
        ({"ci95": [0.3, 0.4]}, "summary.json ci95"),
        ({"success_rate_bounds": None}, "summary.json success_rate_bounds"),
        ({"sim_steps": 1}, "summary.json sim_steps"),
    ],
)
def test_each_condition_is_named(tmp_path: Path, changes: dict[str, Any], condition: str) -> None:
    assert failed(write_run(tmp_path / "run", solved(0.4, 3), **changes)) == [condition]


def test_a_few_questions_answered_otherwise_are_rounding(tmp_path: Path) -> None:
    assert failed(write_run(tmp_path / "run", solved(0.4, 3), audit={**AUDIT, "action_flips": 1})) == []


def test_the_validation_split_and_short_runs_are_no_submissions(tmp_path: Path) -> None:
    val = write_run(tmp_path / "val", solved(0.4, 3, 120), split="val")
    assert failed(val) == ["split", "scenarios_hash", "episodes"]
    wanted = {check.what: check.wanted for check in check_run(val)}
    assert wanted["episodes"] == str(EPISODES), "of the test list"
    assert failed(write_run(tmp_path / "short", solved(0.4, 3, 120))) == ["episodes"]


def test_a_few_lost_episodes_are_within_the_limit_and_more_are_not(tmp_path: Path) -> None:
    lost = np.zeros(EPISODES, bool)
    lost[7] = True
    assert failed(write_run(tmp_path / "one", solved(0.4, 3), lost=lost)) == ["infra_errors"]  # 1 of 300: over 0.1 %


def test_a_summary_that_disagrees_with_the_rows(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", solved(0.4, 3), successes=200, success_rate=200 / EPISODES)
    (message,) = [check.found for check in check_run(folder) if not check.passed]
    assert "successes" in message and failed(folder) == ["episodes.parquet"]


def test_edited_files_break_the_seal_and_a_new_seal_does_not_mend_them(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", solved(0.4, 3))
    summary = json.loads((folder / "summary.json").read_text())
    summary["ci95"] = [0.9, 0.95]
    (folder / "summary.json").write_text(json.dumps(summary))
    assert failed(folder) == ["seal", "summary.json ci95"]
    reseal(folder)
    assert failed(folder) == ["summary.json ci95"]


def test_rows_of_other_scenarios_are_found(tmp_path: Path) -> None:
    """Two rows change places but keep their numbers; the counts are the same."""
    folder = write_run(tmp_path / "run", solved(0.4, 3))
    table = pq.read_table(folder / EPISODES_FILE)
    names = table["scenario"].to_pylist()
    names[4], names[9] = names[9], names[4]
    table = table.set_column(0, "scenario", pa.array(names))
    leaves = row_leaves(table)
    (folder / EPISODES_FILE).write_bytes(to_parquet(table))
    (folder / LEAVES_FILE).write_bytes(b"".join(leaves))
    reseal(folder, merkle_root(leaves))
    assert failed(folder) == ["episodes.parquet scenario"]


def test_a_run_of_one_split_is_not_passed_off_as_another(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", solved(0.4, 3))
    reseal(folder, split="val")
    assert failed(folder) == ["summary.json split"]


def test_folders_that_hold_no_finished_run(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", solved(0.4, 3))
    (folder / RUN_FILE).unlink()
    for place in (folder, tmp_path / "none"):
        with pytest.raises(MissingFileError):
            check_run(place)


def test_names_on_the_board(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", solved(0.4, 3))
    assert make_entry(folder).run.policy == "my_policy"
    assert make_entry(folder, "ours-2").run.policy == "ours-2"
    for taken in ("random", "tae-joint", "tae-better", "joint", "published", "learned"):
        with pytest.raises(SubmissionError, match="built-in"):
            make_entry(folder, taken)
    with pytest.raises(SubmissionError, match="'separate' is the name of"):
        make_entry(write_run(tmp_path / "file", solved(0.4, 3), policy="separate"))
    with pytest.raises(InputError):
        make_entry(folder, "two words")
    with pytest.raises(InputError):
        make_entry(folder, link="ftp://x")
    built_in = write_run(tmp_path / "random", solved(0.1, 3), policy="random")
    assert make_entry(built_in).run.tag == "random"


def test_every_condition_is_in_the_guide(tmp_path: Path) -> None:
    """What a refusal names can be looked up; the many fields of two files are one line there each."""
    guide = (Path(__file__).resolve().parents[3] / "docs" / "submit.md").read_text(encoding="utf-8")
    for check in check_run(write_run(tmp_path / "run", solved(0.4, 3))):
        what = check.what if not check.what.startswith(("run.json", "summary.json")) else check.what.split()[0]
        assert f"`{what}" in guide, check.what
