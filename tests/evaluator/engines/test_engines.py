"""The built-in engines keep the contract of engines; and what the process engine survives besides."""

from __future__ import annotations

import json
import os
import signal
import sys
import types
from pathlib import Path
from typing import Any

import psutil
import pytest

from evaluator.engines import Engine, InfraError, Job, JobResult, default_workers, make_engine
from evaluator.engines.base import load_attribute
from evaluator.engines.child import THREAD_CAPS, call_in_child
from evaluator.engines.inline import InlineEngine
from evaluator.engines.process import ProcessEngine
from evaluator.run.plan import job_batches
from evaluator.testing.engines import EngineContract, IsolatedEngineContract
from rema_data.errors import InfrastructureError, InputError
from rema_data.schema import StepOutcome
from tests.evaluator.fakes import FAULTS, SIMULATOR, FakeSimulator, fake_jobs


def collect(engine: Engine, jobs: list[Job]) -> dict[int, JobResult]:
    found = [result for part in engine.map(job_batches(jobs)) for result in part]
    engine.close()
    assert sorted(result.key for result in found) == sorted(job.key for job in jobs)
    return {result.key: result for result in found}


def order(monkeypatch: pytest.MonkeyPatch, **faults: Any) -> None:
    monkeypatch.setenv(FAULTS, json.dumps(faults))


def expected(jobs: list[Job]) -> dict[int, StepOutcome]:
    simulator = FakeSimulator()
    return {job.key: simulator.run(job.situation, job.action) for job in jobs}


class TestInline(EngineContract):
    def make_engine(self, factory: str, episode_limit_s: float) -> Engine:
        return InlineEngine(factory)


class TestProcess(IsolatedEngineContract):
    def make_engine(self, factory: str, episode_limit_s: float) -> Engine:
        return ProcessEngine(factory, 2, episode_limit_s=episode_limit_s)


class TestOneProcess(IsolatedEngineContract):
    def make_engine(self, factory: str, episode_limit_s: float) -> Engine:
        return ProcessEngine(factory, 1, episode_limit_s=episode_limit_s)


def test_worker_that_dies_once_costs_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    order(monkeypatch, die_once=[7, 40], marks=str(tmp_path))
    jobs = fake_jobs(60)
    results = collect(ProcessEngine(SIMULATOR, 2), jobs)
    monkeypatch.delenv(FAULTS)
    assert {key: result.outcome for key, result in results.items()} == expected(jobs)
    assert {key for key, result in results.items() if result.attempt == 2} == {7, 40}


@pytest.mark.parametrize("workers", [1, 2])
def test_a_job_that_kills_its_worker_is_given_up(monkeypatch: pytest.MonkeyPatch, workers: int) -> None:
    order(monkeypatch, die=[3, 11], **{"raise": [20]})
    results = collect(ProcessEngine(SIMULATOR, workers), fake_jobs(40))
    lost = {key: result.outcome for key, result in results.items() if isinstance(result.outcome, InfraError)}
    assert {key: error.reason for key, error in lost.items()} == {3: "died", 11: "died", 20: "raised"}
    assert "SIGKILL" in lost[3].detail
    assert "scenario 20 is odd" in lost[20].detail


def test_worker_killed_from_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    order(monkeypatch, delay_s=0.005)
    jobs, engine = fake_jobs(120), ProcessEngine(SIMULATOR, 2)
    found: list[JobResult] = []
    for part in engine.map(job_batches(jobs)):
        found.extend(part)
        if len(found) >= 20 and engine.replaced == 0:
            victim = next(iter(engine._seats.values())).process
            os.kill(victim.pid, signal.SIGKILL)
            victim.wait()
    engine.close()
    assert engine.replaced == 1
    assert sorted(result.key for result in found) == list(range(120))
    assert {result.key: result.outcome for result in found} == expected(jobs)


def test_leaking_worker_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    order(monkeypatch, leak_bytes=2**20)
    engine = ProcessEngine(SIMULATOR, 1, growth_limit_bytes=30 * 2**20)
    results = collect(engine, fake_jobs(100))
    assert engine.replaced >= 2
    assert {result.attempt for result in results.values()} == {1}


def test_no_worker_outlives_an_abandoned_map(monkeypatch: pytest.MonkeyPatch) -> None:
    order(monkeypatch, delay_s=0.01)
    before = psutil.Process().children(recursive=True)  # what other tests of this process have left, such as trackers
    engine = ProcessEngine(SIMULATOR, 2)
    running = engine.map(job_batches(fake_jobs(200)))
    next(running)
    children = [child for child in psutil.Process().children(recursive=True) if child not in before]
    with pytest.raises(KeyboardInterrupt):
        running.throw(KeyboardInterrupt())  # type: ignore[attr-defined]
    assert len(children) >= 2
    assert not any(child.is_running() for child in children)


def test_simulator_that_cannot_be_built(monkeypatch: pytest.MonkeyPatch) -> None:
    order(monkeypatch, broken=True)
    with pytest.raises(InfrastructureError, match="cannot be built"):
        collect(ProcessEngine(SIMULATOR, 2), fake_jobs(30))


def test_workers_are_light_capped_and_alone_in_their_group() -> None:
    seen = call_in_child("tests.evaluator.engines.light:inside")
    assert seen["caps"] == dict.fromkeys(THREAD_CAPS, "1")
    assert seen["heavy"] == []
    assert seen["group"] != os.getpgrp()


def test_call_in_child_reports_what_went_wrong() -> None:
    with pytest.raises(InfrastructureError, match="nothing_here"):
        call_in_child("tests.evaluator.engines.light:nothing_here")


def test_what_an_engine_cannot_be_made_with() -> None:
    assert default_workers() >= 1
    for call in (lambda: make_engine("process", 0), lambda: load_attribute("json")):
        with pytest.raises(InputError):
            call()


def test_the_ray_engine_without_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match="not installed") as caught:
        make_engine("ray")
    assert "rema[ray]" in caught.value.hint


def test_how_many_simulators_an_engine_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    # Ray reads its authentication when it is first imported, and the cluster of test_ray.py has its own.
    monkeypatch.setitem(sys.modules, "ray", types.ModuleType("ray"))
    assert make_engine("inline", 7).workers == 1
    assert make_engine("process", 7).workers == make_engine("ray", 7).workers == 7
    assert make_engine("process").workers == default_workers()
