"""A run's tables are a function of scenarios and policy alone: not of workers, engines, order, kills or resumes."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import psutil
import pyarrow.parquet as pq
import pytest
from filelock import FileLock

from evaluator.run.environment import source_digest
from evaluator.run.folder import RunFolder
from evaluator.runner import run_evaluation
from evaluator.runner.shards import RunShard
from rema_data.errors import (
    InfrastructureError,
    InputError,
    IntegrityError,
    PolicyFailureError,
    RunMismatchError,
    StorageError,
    SubmissionError,
)
from tests.evaluator.fakes import FAULTS, FakePolicyProcess, fake_backend, fake_config

LONG = "grasp_grasp_push"


def table(output: Path) -> bytes:
    """Everything that must not depend on how a run went."""
    return b"".join((output / name).read_bytes() for name in ("results.parquet", "actions.bin"))


def run(output: Path, process: FakePolicyProcess | None = None, **changes: Any) -> dict[str, Any]:
    """A run without audit, which has tests of its own."""
    fields = {"audit_share": 0.0, **changes}
    return run_evaluation(fake_config(output, **fields), backend=fake_backend(process)).summary


def running(process: psutil.Process) -> bool:
    try:
        return bool(process.is_running() and process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


@pytest.fixture
def reference(fake_home: Path) -> bytes:
    """Table of the reference engine, end to end."""
    run(fake_home / "reference", task=LONG, protocol="end-to-end", engine="inline", order="forward")
    return table(fake_home / "reference")


def test_same_bytes_for_any_workers_and_order(reference: bytes, fake_home: Path) -> None:
    for workers, order in ((1, "shuffled"), (2, "reverse"), (3, "forward")):
        run(fake_home / f"run{workers}", task=LONG, protocol="end-to-end", workers=workers, order=order)
        assert table(fake_home / f"run{workers}") == reference, f"{workers} workers, {order}"


def test_same_bytes_after_kill_of_the_whole_run(
    reference: bytes, fake_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    output = fake_home / "run"
    monkeypatch.setenv(FAULTS, json.dumps({"delay_s": 0.005}))
    command = [sys.executable, "-m", "tests.evaluator.fakes", str(output), LONG, "end-to-end"]
    with subprocess.Popen(command, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}) as evaluation:
        deadline = time.monotonic() + 30
        journal = output / "records" / "outcomes-0001.jsonl"
        while time.monotonic() < deadline and not (journal.exists() and journal.read_bytes().count(b"\n") > 60):
            time.sleep(0.02)
        workers = psutil.Process(evaluation.pid).children(recursive=True)
        evaluation.send_signal(signal.SIGKILL)
    assert len(workers) >= 2
    while time.monotonic() < deadline + 5 and any(map(running, workers)):
        time.sleep(0.02)
    assert not any(map(running, workers))
    assert not (output / "results.parquet").exists()
    monkeypatch.delenv(FAULTS)
    journal.write_bytes(journal.read_bytes()[:-17])  # a torn line as well

    process = FakePolicyProcess()
    summary = run(output, process, task=LONG, protocol="end-to-end")
    assert table(output) == reference
    assert summary["segments"] == 2
    assert process.asked < 200 + summary["funnel"][1]["attempted"] + summary["funnel"][2]["attempted"]
    assert set(pq.read_table(output / "timings.parquet").column("segment").to_pylist()) == {1, 2}


def test_finished_run_does_nothing_again(fake_home: Path) -> None:
    first = run(fake_home / "run")
    process = FakePolicyProcess()
    before = table(fake_home / "run")
    assert run(fake_home / "run", process) == first
    assert process.asked == 0
    assert table(fake_home / "run") == before


def test_more_episodes_extend_a_run(fake_home: Path) -> None:
    run(fake_home / "whole", episodes=300)
    run(fake_home / "run", episodes=100)
    process = FakePolicyProcess()
    assert run(fake_home / "run", process, episodes=300)["episodes"] == 300
    assert process.asked == 236  # whole batches of 64: the 36 known answers of the second are not replaced
    assert table(fake_home / "run") == table(fake_home / "whole")
    with pytest.raises(RunMismatchError, match="episodes are 300"):
        run(fake_home / "run", episodes=200)


def test_a_run_that_is_not_extended_after_all_keeps_its_seal(fake_home: Path) -> None:
    """Asked for more by mistake, and stopped before anything was played."""
    first = run(fake_home / "run", episodes=100)
    before = (fake_home / "run" / "run.json").read_bytes()
    with pytest.raises(KeyboardInterrupt), RunFolder.locked(fake_home / "run", json.loads(before)["identity"], 300):
        raise KeyboardInterrupt
    assert (fake_home / "run" / "run.json").read_bytes() == before
    assert run(fake_home / "run", episodes=100) == first


def test_results_without_records_are_not_taken_over(fake_home: Path) -> None:
    run(fake_home / "run")
    shutil.rmtree(fake_home / "run" / "records")
    before = {path.name: path.read_bytes() for path in (fake_home / "run").iterdir() if path.is_file()}
    with pytest.raises(RunMismatchError, match="the policy has changed since"):
        run_evaluation(fake_config(fake_home / "run"), backend=fake_backend(digest="other"))
    assert {path.name: path.read_bytes() for path in (fake_home / "run").iterdir() if path.is_file()} == before


def test_conditional_summary(fake_home: Path) -> None:
    summary = run(fake_home / "run", task=LONG)
    rows = pq.read_table(fake_home / "run" / "results.parquet")
    assert summary["episodes"] == summary["eligible"] == 200
    assert summary["successes"] == sum(rows.column("success").to_pylist())
    assert sum(summary["failures"].values()) == 200 - summary["successes"]
    assert summary["ci95"][0] < summary["success_rate"] < summary["ci95"][1]
    assert summary["success_rate_bounds"] == [summary["success_rate"]] * 2
    assert rows.column("step2_action").null_count == 200
    assert rows.column("step3_action").null_count == 0
    assert json.loads((fake_home / "run" / "summary.json").read_text()) == summary
    assert summary["seconds"]["total"] >= summary["seconds"]["simulate"] > 0
    header = json.loads((fake_home / "run" / "run.json").read_text())
    segment = header["segments"][0]
    assert segment["finished"] == 200 and header["policy"]["privileged"] is False
    assert {"commit", "dirty", "machine", "versions", "isolation"} <= segment.keys() and segment["device"] == "cpu"
    assert {name: len(digest) for name, digest in segment["packages"].items()} == dict.fromkeys(
        ("rema_data", "evaluator", "baselines"), 64
    )
    assert len(header["seal"]) == 64 and summary["unfinished"] == 0


def test_the_sandbox_of_the_policy_is_recorded(fake_home: Path) -> None:
    class Walls:
        def to_dict(self) -> dict[str, Any]:
            return {"level": "L2", "up": {"files": "Landlock"}}

    class Walled(FakePolicyProcess):
        isolation = Walls()

    run(fake_home / "run", Walled(), episodes=5, engine="inline")
    header = json.loads((fake_home / "run" / "run.json").read_text())
    assert header["segments"][0]["isolation"] == {"level": "L2", "up": {"files": "Landlock"}}


def test_the_digest_of_a_package_is_that_of_its_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "measured_package"
    package.mkdir()
    monkeypatch.syspath_prepend(str(tmp_path))
    digests = []
    for name, text in (("__init__.py", "raise ImportError"), ("a.py", "1"), ("a.py", "2")):
        (package / name).write_text(text)
        digests.append(source_digest("measured_package"))
    (package / "notes.txt").write_text("no code")
    assert len(set(digests)) == 3 and source_digest("measured_package") == digests[-1]


def test_end_to_end_funnel(reference: bytes, fake_home: Path) -> None:
    summary = json.loads((fake_home / "reference" / "summary.json").read_text())
    funnel = summary["funnel"]
    assert [row["attempted"] for row in funnel] == [200, *(row["succeeded"] for row in funnel[:-1])]
    assert funnel[-1]["succeeded"] == summary["successes"]
    assert not (fake_home / "reference" / ".observations").exists()


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"task": LONG}, "task"),
        ({"protocol": "end-to-end"}, "protocol"),
        ({"digest": "other"}, "policy_digest"),
        ({"parameters": "other"}, "fingerprint"),
    ],
)
def test_folder_of_another_run_is_refused(
    fake_home: Path, monkeypatch: pytest.MonkeyPatch, change: dict[str, str], field: str
) -> None:
    run(fake_home / "run", episodes=5, engine="inline")
    before = (fake_home / "run" / "run.json").read_bytes()
    if "parameters" in change:
        monkeypatch.setenv("REMA_FAKE_PARAMETERS", change.pop("parameters"))
    backend = fake_backend(digest=change.pop("digest", "d"))
    config = fake_config(fake_home / "run", episodes=5, engine="inline", **change)
    with pytest.raises(RunMismatchError, match=f"its {field} is"):
        run_evaluation(config, backend=backend)
    assert (fake_home / "run" / "run.json").read_bytes() == before


def test_two_runs_in_one_folder_are_refused(fake_home: Path) -> None:
    (fake_home / "run").mkdir()
    with FileLock(fake_home / "run" / ".lock"), pytest.raises(InputError, match="another process"):
        run(fake_home / "run", episodes=5)


def test_a_few_policy_faults_are_failed_episodes(fake_home: Path) -> None:
    summary = run(fake_home / "run", FakePolicyProcess(faulty=0.05))
    assert 0 < summary["policy_errors"] == summary["failures"]["policy_error"] <= 20
    assert summary["eligible"] == 200


@pytest.mark.parametrize("episodes", [5, 300])
def test_many_policy_faults_end_the_run(fake_home: Path, episodes: int) -> None:
    process = FakePolicyProcess(faulty=0.5)
    with pytest.raises(PolicyFailureError, match="no idea"):
        run(fake_home / "run", process, episodes=episodes)
    assert process.asked in ({5} if episodes == 5 else {64 + 44, 128})  # the last, short question may come first
    summary = json.loads((fake_home / "run" / "summary.json").read_text())
    assert summary["policy_errors"] > 0
    assert pq.read_table(fake_home / "run" / "results.parquet").num_rows == episodes


def test_infrastructure_errors_are_bounded_and_tried_again(fake_home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(fake_home / "whole")
    monkeypatch.setenv(FAULTS, json.dumps({"die": [17]}))
    with pytest.raises(InfrastructureError, match="1 of 200 .* scenario 17: died"):
        run(fake_home / "run")
    summary = json.loads((fake_home / "run" / "summary.json").read_text())
    low, high = summary["success_rate_bounds"]
    assert summary["infra_errors"] == 1 and summary["eligible"] == 199
    assert high - low == pytest.approx(1 / 200)
    monkeypatch.delenv(FAULTS)
    assert run(fake_home / "run")["infra_errors"] == 0
    assert table(fake_home / "run") == table(fake_home / "whole")


def test_full_disk_can_be_resumed(fake_home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(fake_home / "whole")
    write, room = os.write, [14_000]

    def small_disk(descriptor: int, data: bytes) -> int:
        if len(data) > 20:  # not the pipes to the workers
            room[0] -= len(data)
            if room[0] < 0:
                write(descriptor, bytes(data)[:11])  # what still fitted
                raise OSError(errno.ENOSPC, "No space left on device")
        return write(descriptor, data)

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", small_disk)
        with pytest.raises(StorageError, match="no space"):
            run(fake_home / "run", engine="inline")
    assert room[0] < 0
    assert not (fake_home / "run" / "results.parquet").exists()
    run(fake_home / "run")
    assert table(fake_home / "run") == table(fake_home / "whole")


def test_interrupt_stops_workers_and_resumes(fake_home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(fake_home / "whole")

    class Impatient:
        done = 0

        def phase(self, name: str, total: int) -> None:
            self.simulating = name == "simulate"

        def advance(self, n: int) -> None:
            self.done += n * self.simulating
            if self.done > 50:
                raise KeyboardInterrupt

        def note(self, text: str) -> None:
            pass

    with pytest.raises(KeyboardInterrupt):
        run_evaluation(fake_config(fake_home / "run"), Impatient(), backend=fake_backend())
    assert [child for child in psutil.Process().children() if "evaluator.engines.worker" in child.cmdline()] == []
    process = FakePolicyProcess()
    run(fake_home / "run", process)
    assert process.asked == 0
    assert table(fake_home / "run") == table(fake_home / "whole")


def test_more_episodes_than_scenarios(fake_home: Path) -> None:
    with pytest.raises(InputError, match="more than the 300"):
        run(fake_home / "run", episodes=301)


@pytest.mark.parametrize("change", [{"episodes": 0}, {"workers": 0}, {"order": "odd"}, {"engine": "x"}, {"task": "y"}])
def test_values_that_cannot_be(tmp_path: Path, change: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        fake_config(tmp_path, **change)


def test_a_folder_without_records_is_taken_over(fake_home: Path) -> None:
    def refuse(*_: Any) -> Any:
        raise SubmissionError("policy cannot be used", hint="fix it and run the same command again")

    output = fake_home / "run"
    with pytest.raises(SubmissionError):
        run_evaluation(fake_config(output, episodes=50), backend=fake_backend(digest="broken", open_policy=refuse))
    assert run_evaluation(fake_config(output, episodes=40), backend=fake_backend(digest="fixed")).summary["eligible"]
    with pytest.raises(RunMismatchError, match="policy_digest"):
        run_evaluation(fake_config(output, episodes=40), backend=fake_backend(digest="third"))


def test_what_a_killed_writer_left_is_swept_away(fake_home: Path) -> None:
    run(fake_home / "run", episodes=5, engine="inline")
    (fake_home / "run" / ".run.json.abcdefgh").write_text("{")
    run(fake_home / "run", episodes=5, engine="inline")
    hidden = {path.name for path in (fake_home / "run").iterdir() if path.name.startswith(".")}
    assert hidden <= {".lock"}


@pytest.mark.parametrize(
    "header", ["{", "[1]", '{"format": 1, "identity": 3, "policy": {}, "episodes": 1, "salt": "5", "segments": []}']
)
def test_damaged_run_header_is_refused(fake_home: Path, header: str) -> None:
    run(fake_home / "run", episodes=5, engine="inline")
    (fake_home / "run" / "run.json").write_text(header)
    with pytest.raises(IntegrityError, match="not a run header"):
        run(fake_home / "run", episodes=5, engine="inline")


def test_run_folder_that_cannot_be(fake_home: Path) -> None:
    (fake_home / "file").touch()
    for path in (fake_home / "file", fake_home / "file" / "x", fake_home / ("n" * 300)):
        with pytest.raises(StorageError, match="cannot write"):
            run(path, episodes=5, engine="inline")


def test_batches_that_no_pipe_should_carry(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="too large"):
        fake_config(tmp_path, batch_size=1_000_000)


def test_a_cluster_is_for_the_ray_engine(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--address"):
        fake_config(tmp_path, address="head:6379")


def test_more_shards_than_batches_are_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="too few for 9 shards"):
        fake_config(tmp_path / "run", shard=RunShard(1, 9), batch_size=64)
    assert not (tmp_path / "run").exists()
