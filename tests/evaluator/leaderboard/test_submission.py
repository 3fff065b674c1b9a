"""What a run must be to become an entry, one condition at a time; the last one is that simulating it gives the same."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from evaluator.leaderboard import leaderboard, submission
from evaluator.leaderboard.submission import Inspection, inspect_run, make_entry
from evaluator.leaderboard.verification import known, verify
from evaluator.protocol import protocol_hash
from evaluator.run.entry import encode, read_entry
from evaluator.run.header import RUN_FILE
from evaluator.run.reading import read_run
from evaluator.run.run import Run
from evaluator.run.seal import RESULTS_FILE
from evaluator.runner import run_evaluation
from rema_data.errors import InputError, MissingFileError, SubmissionError
from tests.evaluator.fakes import FakePolicyProcess, fake_backend, fake_config
from tests.evaluator.replay.conftest import with_value
from tests.evaluator.runs import AUDIT, EPISODES, STOPPED, reseal, solved, use_installation, write_run

WORLD: dict[str, Any] = {"digest": "d" * 64, "protocol_hash": protocol_hash}


@pytest.fixture(autouse=True)
def _manifests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use_installation(tmp_path, monkeypatch)


@pytest.fixture
def confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every replay confirms its run: for runs whose outcomes a test made up."""
    report = SimpleNamespace(findings=(), verified=True)
    monkeypatch.setattr(submission, "replay", lambda folder, **_: report)


def failed(folder: Path) -> list[str]:
    """Conditions that a run does not meet; submitting it says the same."""
    inspection = inspect_run(folder)
    names = [check.what for check in inspection.checks if not check.passed]
    if names:
        with pytest.raises(SubmissionError) as caught:
            make_entry(inspection)
        assert caught.value.facts["failed"] == names and caught.value.exit_code == 3
        assert all(name in caught.value.message for name in names)
    return names


def entry_of(folder: Path, name: str = "", link: str = "", **declared: bool) -> Run:
    return make_entry(inspect_run(folder), name, link, **declared)


def play(folder: Path, task: str = "grasp", protocol: str = "conditional") -> Path:
    """A run of the fake world, with some policy errors."""
    config = fake_config(folder, task, protocol=protocol, episodes=EPISODES, engine="inline")
    run_evaluation(config, backend=fake_backend(FakePolicyProcess(faulty=0.05), **WORLD))
    return folder


def inspected(folder: Path) -> Inspection:
    return inspect_run(folder, engine="inline", backend=fake_backend(**WORLD))


@pytest.mark.parametrize(("task", "protocol"), [("grasp", "conditional"), ("grasp_push", "end-to-end")])
def test_a_whole_run_becomes_an_entry_whose_actions_give_the_same(tmp_path: Path, task: str, protocol: str) -> None:
    folder = play(tmp_path / "run", task, protocol)
    inspection = inspected(folder)
    assert inspection.valid and inspection.checks[-1].what == "simulated"
    entry = make_entry(inspection, link="https://example.org")
    path = tmp_path / "entry.json"
    path.write_bytes(encode(entry))
    assert encode(make_entry(inspection, link="https://example.org")) == path.read_bytes()
    backend, run = fake_backend(**WORLD), read_run(folder)
    for found in (known(read_entry(path), backend), verify(read_entry(path), backend=backend, again=True, workers=1)):
        assert found.counts == run.counts and found.verified == "here"
        assert np.array_equal(found.outcomes.success, run.outcomes.success)
    board = leaderboard([path, folder], published=False, backend=backend)
    assert [(row.policy, row.rank, row.successes) for row in board.rows] == [("fake", 1, run.counts.successes)]


@pytest.mark.parametrize("claim", ["success", "failure", "evidence"])
def test_a_row_that_its_action_does_not_give_is_refused_by_name(tmp_path: Path, claim: str) -> None:
    folder = play(tmp_path / "run")
    table = pq.read_table(folder / RESULTS_FILE)
    row = next(n for n, label in enumerate(table["failure"].to_pylist()) if label == "missed")
    edits: dict[str, dict[str, Any]] = {
        "success": {
            "success": True,
            "failure": None,
            "failed_step": None,
            "step0_success": True,
            "step0_failure": None,
        },
        "failure": {"failure": "slipped", "step0_failure": "slipped"},
        "evidence": {"step0_lift_m": 0.5},
    }
    for column, value in edits[claim].items():
        table = with_value(table, column, row, value)
    reseal(folder, table)
    assert read_run(folder).seal_state == "whole"
    inspection = inspected(folder)
    assert [check.what for check in inspection.checks if not check.passed] == ["simulated"]
    with pytest.raises(SubmissionError, match=f"grasp/test/{row:05d}"):
        make_entry(inspection)


def test_another_simulator_confirms_within_a_bound_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = play(tmp_path / "run")
    monkeypatch.setenv("REMA_FAKE_PARAMETERS", "other")
    (check,) = [check for check in inspected(folder).checks if not check.passed]
    assert check.what == "simulated" and check.found.startswith("another simulator: up to 1.2")  # 300 are too few


def test_nothing_is_believed_about_rows_that_are_missing(tmp_path: Path) -> None:
    """The rows of the failed episodes are gone, the summary says that none is unfinished."""
    folder = write_run(tmp_path / "run", solved(0.4, 3), unplayed=~solved(0.4, 3))
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["unfinished"] > 100
    (folder / "summary.json").write_text(json.dumps({**summary, "unfinished": 0}, indent=2) + "\n")
    assert failed(folder) == ["summary.json", "unfinished"]


@pytest.mark.parametrize(
    ("changes", "condition"),
    [
        ({"stopped_early": STOPPED}, "stopped_early"),
        ({"unplayed": np.arange(EPISODES) < 1}, "unfinished"),
        ({"unfinished": 1}, "summary.json"),
        ({"policy": "tae-best"}, "name"),
        ({"policy": "random", "digest": "e" * 64}, "name"),
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


@pytest.mark.usefixtures("confirmed")
def test_a_few_answers_that_differ_are_rounding(tmp_path: Path) -> None:
    assert failed(write_run(tmp_path / "run", solved(0.4, 3), audit={**AUDIT, "action_flips": 1})) == []


def test_the_validation_split_and_short_runs_are_no_submissions(tmp_path: Path) -> None:
    val = write_run(tmp_path / "val", solved(0.4, 3, 120), split="val")
    assert failed(val) == ["split", "scenarios_hash", "episodes"]
    required = {check.what: check.required for check in inspect_run(val).checks}
    assert required["episodes"] == str(EPISODES), "of the test list"
    assert failed(write_run(tmp_path / "short", solved(0.4, 3, 120))) == ["episodes"]


def test_a_few_lost_episodes_are_within_the_limit_and_more_are_not(tmp_path: Path) -> None:
    lost = np.zeros(EPISODES, bool)
    lost[7] = True
    assert failed(write_run(tmp_path / "one", solved(0.4, 3), lost=lost)) == ["infra_errors"]  # 1 of 300: over 0.1 %


def test_a_summary_that_disagrees_with_the_rows(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", solved(0.4, 3), successes=200, success_rate=200 / EPISODES)
    (message,) = [check.found for check in inspect_run(folder).checks if not check.passed]
    assert message.startswith("successes says 200, results.parquet gives 1") and failed(folder) == ["summary.json"]


def test_an_edited_summary_is_found_and_a_new_seal_does_not_hide_it(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", solved(0.4, 3))
    summary = json.loads((folder / "summary.json").read_text())
    summary["ci95"] = [0.9, 0.95]
    (folder / "summary.json").write_text(json.dumps(summary))
    assert failed(folder) == ["summary.json"]
    reseal(folder, ci95=[0.9, 0.95])
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
    assert failed(folder) == ["split", "results.parquet scenario"]


def test_folders_that_hold_no_finished_run(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", solved(0.4, 3))
    (folder / RUN_FILE).unlink()
    for place in (folder, tmp_path / "none"):
        with pytest.raises(MissingFileError):
            inspect_run(place)


@pytest.mark.usefixtures("confirmed")
@pytest.mark.parametrize(
    "name", ["random", "Random", "tae-joint", "tae-better", "joint", "published", "learned", "simulator"]
)
def test_names_of_others_cannot_be_taken(tmp_path: Path, name: str) -> None:
    folder = write_run(tmp_path / "run", solved(0.4, 3))
    assert entry_of(folder).policy == "my_policy" and entry_of(folder, "ours-2").policy == "ours-2"
    with pytest.raises(SubmissionError, match="name of"):
        entry_of(folder, name)


@pytest.mark.usefixtures("confirmed")
def test_names_and_kinds_that_are_ones_own(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", solved(0.4, 3))
    with pytest.raises(InputError):
        entry_of(folder, "two words")
    with pytest.raises(InputError):
        entry_of(folder, link="ftp://x")
    built_in = write_run(tmp_path / "random", solved(0.1, 3), policy="random")
    assert entry_of(built_in).tag == "random" and entry_of(built_in, "mine").tag == "submitted"
    assert entry_of(folder).tag == "submitted" and entry_of(folder, simulator=True).tag == "simulator"
    said = write_run(tmp_path / "said", solved(0.4, 3), policy="said", simulator=True)
    assert entry_of(said).tag == "simulator" == entry_of(said, "renamed").tag
    privileged = write_run(tmp_path / "sees", solved(0.4, 3), policy="sees", privileged=True)
    assert entry_of(privileged).tag == "privileged"


@pytest.mark.usefixtures("confirmed")
def test_an_entry_says_what_its_policy_was_trained_on(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", solved(0.4, 3))
    clean, declared = entry_of(folder), entry_of(folder, adapted=True)
    assert "adapted" not in json.loads(encode(clean))["policy"]
    assert not clean.adapted and declared.adapted
    said = entry_of(write_run(tmp_path / "said", solved(0.4, 3), policy="said", adapted=True))
    for entry in (clean, declared, said):
        (tmp_path / "entry.json").write_bytes(encode(entry))
        assert read_run(tmp_path / "entry.json").adapted == entry.adapted
    built_in = write_run(tmp_path / "random", solved(0.1, 3), policy="random")
    with pytest.raises(SubmissionError, match="installed as clean-trained"):
        entry_of(built_in, adapted=True)


@pytest.mark.usefixtures("confirmed")
def test_every_condition_is_in_the_guide(tmp_path: Path) -> None:
    """What a refusal names can be looked up; the many fields of two files are one line there each."""
    guide = (Path(__file__).resolve().parents[3] / "docs" / "submit.md").read_text(encoding="utf-8")
    for check in inspect_run(write_run(tmp_path / "run", solved(0.4, 3))).checks:
        what = check.what if not check.what.startswith(("run.json", "summary.json")) else check.what.split()[0]
        assert f"`{what}" in guide, check.what
