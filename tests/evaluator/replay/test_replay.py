"""A replay confirms what is true, finds what is false however well it is sealed, and bounds what it did not look at."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from filelock import FileLock

from evaluator.replay import ReplayReport, replay
from evaluator.run.actions import POLICY_ERROR, decode_actions
from evaluator.run.counts import count_rows, summary_numbers
from evaluator.run.reading import read_run
from evaluator.runner import run_evaluation
from evaluator.scenarios import VERSION
from evaluator.statistics import clopper_pearson
from rema_data import grid
from rema_data.errors import (
    InputError,
    MissingFileError,
    PolicyFailureError,
    RunMismatchError,
)
from rema_data.schema import Situation, StepOutcome
from tests.evaluator.fakes import (
    FakePolicyProcess,
    FakeSimulator,
    fake_backend,
    fake_config,
    scenario_number,
    write_fake_list,
)
from tests.evaluator.runs import reseal

from .conftest import EPISODES, LONG, with_value

Copy = Callable[[str], Path]


class OtherSimulator(FakeSimulator):
    """Another world: another lift everywhere, and no success in scenarios 5, 15, 25 and so on."""

    def run(self, situation: Situation, action: int) -> StepOutcome:
        outcome = super().run(situation, action)
        if scenario_number(situation) % 10 == 5:
            return StepOutcome(False, None, arm="left", lift_m=7.0)
        return replace(outcome, lift_m=outcome.lift_m + 1)


def play(run: Path, **changes: Any) -> ReplayReport:
    fields: dict[str, Any] = {"engine": "inline", "backend": fake_backend(), **changes}
    return replay(run, **fields)


@pytest.mark.parametrize("name", ["short", "long"])
def test_a_true_run_is_confirmed_without_its_policy(home: Path, name: str) -> None:
    before = {path: path.read_bytes() for path in (home / name).glob("*") if path.is_file()}

    def refuse(*_: object) -> Any:
        raise AssertionError("the policy was opened")

    report = play(home / name, backend=fake_backend(open_policy=refuse, policy_digest=refuse))
    assert report.ok and report.same_simulator and report.findings == ()
    assert (report.episodes, report.replayed, report.lost, report.unfinished) == (EPISODES, EPISODES, 0, 0)
    assert report.different_ci95 == (0.0, 0.0) and report.seed is None
    assert {path: path.read_bytes() for path in before} == before


def test_the_workers_engine_confirms_the_inline_run(home: Path) -> None:
    assert play(home / "long", engine="process", workers=2).ok


def test_policy_errors_are_in_the_log_and_are_replayed(home: Path) -> None:
    run = read_run(home / "short", with_findings=True)
    assert run.folder.actions is not None
    assert int((run.folder.actions == POLICY_ERROR).sum()) == run.summary["policy_errors"] > 0


def test_end_to_end_every_step_is_played_from_the_log(home: Path) -> None:
    log = decode_actions((home / "long" / "actions.bin").read_bytes(), EPISODES, 4)
    table = pq.read_table(home / "long" / "results.parquet")
    assert log is not None
    for step in range(4):
        recorded = table.column(f"step{step}_action").to_pylist()
        assert [None if value >= grid.ACTIONS - 2 else value for value in log[:, step].tolist()] == recorded


def test_a_fraction_is_drawn_again_and_bounds_the_rest(home: Path) -> None:
    first, second = (play(home / "short", fraction=0.25) for _ in range(2))
    assert first.ok and first.replayed == EPISODES // 4
    assert first.seed != second.seed
    assert first.different_ci95 == clopper_pearson(0, EPISODES // 4)
    assert play(home / "short", fraction=0.25, seed=first.seed).to_dict() == first.to_dict()
    nothing = play(home / "short", fraction=0)
    assert nothing.ok and nothing.replayed == 0 and nothing.different_ci95 == (0.0, 1.0)
    with pytest.raises(InputError, match="fraction"):
        play(home / "short", fraction=1.5)


@pytest.mark.parametrize(
    ("column", "change"),
    [
        ("success", lambda value: not value),
        ("failure", lambda value: "slipped"),
        ("step0_peak_force_n", lambda value: 1e-12 if value is None else value + 1e-9),
        ("target_y_m", lambda value: value + 0.1),
        ("step0_x_m", lambda value: value + grid.PIXEL_M),
    ],
)
def test_a_false_row_is_found_though_everything_is_sealed_again(
    copy_of: Copy, column: str, change: Callable[[Any], Any]
) -> None:
    run = copy_of("short")
    table = pq.read_table(run / "results.parquet")
    forged = with_value(table, column, 60, change(table.column(column)[60].as_py()))
    reseal(run, forged, **summary_numbers(count_rows(forged, (0,)), forged))
    assert read_run(run).seal_state == "whole"
    report = play(run)
    assert [finding.file for finding in report.findings] == ["results.parquet"]
    assert report.findings[0].where == f"row 60 ({VERSION}/grasp/test/00060)"
    assert column in report.findings[0].detail
    assert report.different_rows == 1 and report.different_ci95 == (1 / EPISODES, 1 / EPISODES)


def test_a_forged_sample_is_caught_with_the_rate_it_was_forged(copy_of: Copy) -> None:
    run = copy_of("short")
    table = pq.read_table(run / "results.parquet")
    failed = [row for row, success in enumerate(table.column("success").to_pylist()) if not success]
    for row in failed:
        for column, value in (("success", True), ("failure", None), ("failed_step", None)):
            table = with_value(table, column, row, value)
    reseal(run, table, **summary_numbers(count_rows(table, (0,)), table))
    report = play(run, fraction=0.5, seed=3)
    low, high = report.different_ci95
    assert low <= len(failed) / EPISODES <= high
    assert report.different_rows == len(report.findings) > 0


def test_a_false_statistic_is_found_though_it_is_sealed_again(copy_of: Copy) -> None:
    run = copy_of("short")
    table = pq.read_table(run / "results.parquet")
    reseal(run, table, success_rate=0.99, policy="better")
    found = {finding.where: finding.detail for finding in play(run, fraction=0).findings}
    assert set(found) == {"success_rate", "policy"}
    assert found["success_rate"].startswith("says 0.99, results.parquet gives 0.")


def test_the_last_bits_of_an_interval_are_another_machines(copy_of: Copy) -> None:
    run = copy_of("short")
    ends = json.loads((run / "summary.json").read_text())["ci95"]
    reseal(run, pq.read_table(run / "results.parquet"), ci95=[math.nextafter(end, 1) for end in ends])
    assert play(run, fraction=0).findings == ()


def test_an_action_that_may_not_be_taken_is_found(copy_of: Copy) -> None:
    run = copy_of("short")
    table = with_value(pq.read_table(run / "results.parquet"), "step0_action", 9, 5)
    reseal(run, table)
    places = {(finding.file, finding.where) for finding in play(run).findings}
    assert ("actions.bin", f"row 9 ({VERSION}/grasp/test/00009), step 0") in places


def test_a_tampered_action_log_is_not_played(copy_of: Copy) -> None:
    run = copy_of("short")
    content = bytearray((run / "actions.bin").read_bytes())
    content[2 * 8] ^= 1
    (run / "actions.bin").write_bytes(content)
    report = play(run)
    assert [finding.file for finding in report.findings] == ["actions.bin"]
    assert report.replayed == EPISODES and report.different_rows == 0


def test_a_header_that_was_changed_is_not_believed(copy_of: Copy) -> None:
    run = copy_of("short")
    text = (run / "run.json").read_text()
    (run / "run.json").write_text(text.replace('"split": "test"', '"split": "val"'))
    report = play(run)
    assert not report.ok and report.replayed == 0


def test_another_simulator_gives_flips_and_no_findings(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REMA_FAKE_PARAMETERS", "other")
    other = fake_backend(simulator="tests.evaluator.replay.test_replay:OtherSimulator")
    report = play(home / "short", backend=other)
    assert report.ok and report.differences == {"parameters": ("p", "other")}
    rows = pq.read_table(home / "short" / "results.parquet").to_pylist()
    asked = [row for row in rows if row["step0_action"] is not None]
    assert report.different_rows == len(asked)
    assert report.flips == sum(row["index"] % 10 == 5 for row in asked) > 0
    share = report.flips / EPISODES
    assert report.flips_ci95 == clopper_pearson(report.flips, EPISODES) and not report.verified
    few = replace(report, flips=20, replayed=10_000, flips_ci95=clopper_pearson(20, 10_000))
    many = replace(report, flips=40, replayed=10_000, flips_ci95=clopper_pearson(40, 10_000))
    assert few.verified and not many.verified, "0.2 % and 0.4 %, at most 0.31 % and 0.54 %"
    partly = play(home / "short", backend=other, fraction=0.5, seed=1)
    assert partly.flips_ci95[0] < share < partly.flips_ci95[1]


def test_the_same_fingerprint_with_other_outcomes_is_a_finding(home: Path) -> None:
    other = fake_backend(simulator="tests.evaluator.replay.test_replay:OtherSimulator")
    report = play(home / "long", backend=other)
    assert not report.ok and report.different_rows == len(report.findings) > 0


def test_another_scenario_list_cannot_be_replayed(home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_fake_list(tmp_path / "manifests", "grasp", 250)
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    with pytest.raises(RunMismatchError, match="another scenario list"):
        play(home / "short")


def test_an_interrupted_run_names_the_command_that_goes_on(home: Path, tmp_path: Path) -> None:
    class Impatient:
        simulating = False

        def phase(self, name: str, total: int) -> None:
            self.simulating = name == "simulate"

        def advance(self, n: int) -> None:
            if self.simulating:
                raise KeyboardInterrupt

        def note(self, text: str) -> None:
            pass

    config = fake_config(tmp_path / "run", episodes=50, engine="inline", audit_share=0.0)
    with pytest.raises(KeyboardInterrupt):
        run_evaluation(config, Impatient(), backend=fake_backend())
    with pytest.raises(MissingFileError, match="interrupted") as caught:
        play(tmp_path / "run")
    assert "rema evaluate fake.py:Policy --task grasp" in caught.value.hint
    with (
        FileLock(tmp_path / "run" / ".lock"),
        pytest.raises(MissingFileError, match="a process is writing in it"),
    ):
        play(tmp_path / "run")
    run_evaluation(config, backend=fake_backend())
    assert play(tmp_path / "run").ok


def test_a_run_without_a_seal_gets_one_from_its_records(copy_of: Copy) -> None:
    """Run folders of before there were seals: the same command again, and nothing is asked or simulated."""
    run = copy_of("long")
    before = (run / "results.parquet").read_bytes(), (run / "actions.bin").read_bytes()
    header = json.loads((run / "run.json").read_text())
    del header["seal"]
    (run / "run.json").write_text(json.dumps(header, indent=2))
    (run / "actions.bin").unlink()
    with pytest.raises(MissingFileError, match="not sealed") as caught:
        play(run)
    assert f"--episodes {EPISODES} --output {run}" in caught.value.hint
    process = FakePolicyProcess()
    config = fake_config(run, LONG, protocol="end-to-end", episodes=EPISODES, engine="inline", audit_share=0.0)
    run_evaluation(config, backend=fake_backend(process))
    assert process.asked == 0
    assert ((run / "results.parquet").read_bytes(), (run / "actions.bin").read_bytes()) == before
    assert play(run).ok


def test_a_run_that_was_cut_short_says_so(home: Path, tmp_path: Path) -> None:
    config = fake_config(tmp_path / "run", episodes=300, engine="inline")
    with pytest.raises(PolicyFailureError):
        run_evaluation(config, backend=fake_backend(FakePolicyProcess(faulty=0.5)))
    report = play(tmp_path / "run")
    assert report.ok and report.unfinished > 100 and report.audit is None
    assert report.replayed + report.unfinished == 300
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["unfinished"] == report.unfinished


def test_a_replay_loads_no_torch_and_no_physics_here() -> None:
    code = (
        "import sys, evaluator.replay, evaluator.cli.replay\nfrom evaluator.runner import default_backend\n"
        "default_backend()\nprint(sorted({'torch', 'pybullet', 'pandas', 'cryptography'} & set(sys.modules)))"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
