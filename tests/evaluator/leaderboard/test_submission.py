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
from evaluator.run.header import RUN_FILE
from evaluator.run.seal import RESULTS_FILE
from rema_data.errors import InputError, MissingFileError, SubmissionError
from tests.evaluator.runs import AUDIT, EPISODES, reseal, solved, write_manifests, write_run


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


@pytest.mark.parametrize("protocol", ["conditional", "end-to-end"])
def test_a_whole_run_becomes_an_entry(tmp_path: Path, protocol: str) -> None:
    passed = [solved(0.8, 1), solved(0.5, 2)] if protocol == "end-to-end" else solved(0.5, 2)
    folder = write_run(tmp_path / "run", passed, task="grasp_push", protocol=protocol)
    assert failed(folder) == []
    entry = make_entry(folder, link="https://example.org")
    assert encode(entry) == encode(make_entry(folder, link="https://example.org"))
    path = tmp_path / "entry.json"
    path.write_bytes(encode(entry))
    found = read_entry(path)
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
        ({"identity": {"fingerprint": {}}}, "run.json fingerprint"),
        ({"policy_digest": "0" * 64}, "summary.json"),
        ({"success_rate": 0.9}, "summary.json"),
        ({"ci95": [0.3, 0.4]}, "summary.json"),
        ({"success_rate_bounds": None}, "summary.json"),
        ({"sim_steps": 1}, "summary.json"),
    ],
)
def test_each_condition_is_named(tmp_path: Path, changes: dict[str, Any], condition: str) -> None:
    assert failed(write_run(tmp_path / "run", solved(0.4, 3), **changes)) == [condition]


def test_a_few_answers_that_differ_are_rounding(tmp_path: Path) -> None:
    assert failed(write_run(tmp_path / "run", solved(0.4, 3), audit={**AUDIT, "action_flips": 1})) == []


def test_the_validation_split_and_short_runs_are_no_submissions(tmp_path: Path) -> None:
    val = write_run(tmp_path / "val", solved(0.4, 3, 120), split="val")
    assert failed(val) == ["split", "scenarios_hash", "episodes"]
    required = {check.what: check.required for check in check_run(val)}
    assert required["episodes"] == str(EPISODES), "of the test list"
    assert failed(write_run(tmp_path / "short", solved(0.4, 3, 120))) == ["episodes"]


def test_a_few_lost_episodes_are_within_the_limit_and_more_are_not(tmp_path: Path) -> None:
    lost = np.zeros(EPISODES, bool)
    lost[7] = True
    assert failed(write_run(tmp_path / "one", solved(0.4, 3), lost=lost)) == ["infra_errors"]  # 1 of 300: over 0.1 %


def test_a_summary_that_disagrees_with_the_rows(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", solved(0.4, 3), successes=200, success_rate=200 / EPISODES)
    (message,) = [check.found for check in check_run(folder) if not check.passed]
    assert message.startswith("successes says 200, results.parquet gives 1") and failed(folder) == ["summary.json"]


def test_edited_files_break_the_seal_and_a_new_seal_does_not_hide_them(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", solved(0.4, 3))
    summary = json.loads((folder / "summary.json").read_text())
    summary["ci95"] = [0.9, 0.95]
    (folder / "summary.json").write_text(json.dumps(summary))
    assert failed(folder) == ["seal", "summary.json"]
    reseal(folder)
    assert failed(folder) == ["summary.json"]


def test_rows_of_other_scenarios_are_found(tmp_path: Path) -> None:
    """Two rows change places but keep their numbers; the counts are the same."""
    folder = write_run(tmp_path / "run", solved(0.4, 3))
    table = pq.read_table(folder / RESULTS_FILE)
    names = table["scenario"].to_pylist()
    names[4], names[9] = names[9], names[4]
    reseal(folder, table.set_column(0, "scenario", pa.array(names)))
    assert failed(folder) == ["results.parquet scenario"]


def test_a_run_of_one_split_is_not_passed_off_as_another(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", solved(0.4, 3))
    reseal(folder, identity={"split": "val"})
    assert failed(folder) == ["summary.json", "split", "results.parquet scenario"]


def test_folders_that_hold_no_finished_run(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", solved(0.4, 3))
    (folder / RUN_FILE).unlink()
    for place in (folder, tmp_path / "none"):
        with pytest.raises(MissingFileError):
            check_run(place)


def test_names_on_the_board(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", solved(0.4, 3))
    assert make_entry(folder).policy == "my_policy"
    assert make_entry(folder, "ours-2").policy == "ours-2"
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
    assert make_entry(built_in).tag == "random"


def test_every_condition_is_in_the_guide(tmp_path: Path) -> None:
    """What a refusal names can be looked up; the many fields of two files are one line there each."""
    guide = (Path(__file__).resolve().parents[3] / "docs" / "submit.md").read_text(encoding="utf-8")
    for check in check_run(write_run(tmp_path / "run", solved(0.4, 3))):
        what = check.what if not check.what.startswith(("run.json", "summary.json")) else check.what.split()[0]
        assert f"`{what}" in guide, check.what
