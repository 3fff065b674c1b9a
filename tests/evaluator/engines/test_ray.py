"""What the ray engine survives, on a cluster of two tiny machines."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest

from evaluator.engines import InfraError, Job, JobResult, make_engine, worker_count
from evaluator.engines.ray import RayEngine
from evaluator.policy import resolve
from evaluator.replay import replay
from evaluator.run.plan import job_batches
from evaluator.runner import EvaluationConfig, run_evaluation
from evaluator.testing.engines import IsolatedEngineContract
from rema_data.errors import InfrastructureError, InputError
from rema_data.schema import StepOutcome
from tests.baselines.rounds.fakes import collect_fake, tree, write_plan
from tests.evaluator.engines.cluster_world import CLUSTER_SIMULATOR, OTHER_MACHINES
from tests.evaluator.engines.conftest import MACHINE
from tests.evaluator.fakes import FakeSimulator, fake_backend, fake_config, fake_fingerprint, fake_jobs
from tests.evaluator.runs import write_suite

pytestmark = pytest.mark.usefixtures("cluster", "order")

Order = Callable[..., None]


@pytest.fixture
def machine(cluster: Any) -> Iterator[Any]:
    """A second machine, for one test."""
    node = cluster.add_node(**MACHINE)
    yield node
    if node in cluster.worker_nodes:
        cluster.remove_node(node)


def simulators(node: Any) -> list[psutil.Process]:
    """Simulation processes of one machine."""
    found = []
    for child in psutil.Process(node.all_processes["raylet"][0].process.pid).children(recursive=True):
        with suppress(psutil.Error):
            if "evaluator.engines.worker" in child.cmdline():
                found.append(child)
    return found


def collect(engine: RayEngine, jobs: list[Job]) -> dict[int, JobResult]:
    found = [result for part in engine.map(job_batches(jobs)) for result in part]
    engine.close()
    assert sorted(result.key for result in found) == [job.key for job in jobs]
    return {result.key: result for result in found}


def expected(jobs: list[Job]) -> dict[int, StepOutcome]:
    simulator = FakeSimulator()
    return {job.key: simulator.run(job.situation, job.action) for job in jobs}


def outcomes(results: dict[int, JobResult]) -> dict[int, StepOutcome | InfraError]:
    return {key: result.outcome for key, result in results.items()}


def lost(results: dict[int, JobResult]) -> dict[int, str]:
    return {key: error.reason for key, error in outcomes(results).items() if isinstance(error, InfraError)}


class TestRay(IsolatedEngineContract):
    def make_engine(self, factory: str, episode_limit_s: float) -> RayEngine:
        return RayEngine(factory, 1, episode_limit_s=episode_limit_s)


def test_outcomes_are_those_of_a_single_machine(machine: Any) -> None:
    jobs, workers = fake_jobs(5000), set()
    found: dict[int, JobResult] = {}

    def until_both_work() -> Iterator[tuple[Job, ...]]:
        for shard in job_batches(jobs):
            if len(workers) < 2:
                yield shard

    engine = RayEngine(CLUSTER_SIMULATOR)
    for part in engine.map(until_both_work()):
        found.update((result.key, result) for result in part)
        workers |= {result.worker for result in part}
    engine.close()
    assert engine.workers == len(workers) == 2
    assert outcomes(found) == expected(jobs[: len(found)])
    assert {result.attempt for result in found.values()} == {1}


class Killer:
    """Kills a machine of a cluster once it simulates."""

    def __init__(self, cluster: Any, machine: Any) -> None:
        self.cluster, self.machine = cluster, machine
        self.notes: list[str] = []

    @property
    def done(self) -> bool:
        return self.machine not in self.cluster.worker_nodes

    def phase(self, name: str, total: int) -> None:
        pass

    def advance(self, n: int) -> None:
        if not self.done and simulators(self.machine):
            self.cluster.remove_node(self.machine, allow_graceful=False)

    def note(self, text: str) -> None:
        self.notes.append(text)


def test_table_of_a_run_whose_machine_is_killed(cluster: Any, machine: Any, fake_home: Path, order: Order) -> None:
    task = "grasp_grasp_push"
    run_evaluation(fake_config(fake_home / "process", task=task), backend=fake_backend())
    order(delay_s=0.01)
    killer = Killer(cluster, machine)
    config = fake_config(fake_home / "ray", engine="ray", task=task)
    result = run_evaluation(config, killer, backend=fake_backend(simulator=CLUSTER_SIMULATOR))
    assert killer.done and any("was redone" in note for note in killer.notes)
    assert result.summary["infra_errors"] == 0
    tables = [(fake_home / name / "results.parquet").read_bytes() for name in ("process", "ray")]
    assert tables[0] == tables[1]
    order()
    report = replay(
        fake_home / "process", fraction=0.2, engine="ray", backend=fake_backend(simulator=CLUSTER_SIMULATOR)
    )
    assert report.ok and report.replayed == 40 and report.lost == 0


@pytest.mark.slow
def test_the_real_world_on_a_machine_that_is_killed(
    cluster: Any, machine: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    killer, tables = Killer(cluster, machine), []
    for engine, sink in (("process", None), ("ray", killer)):
        config = EvaluationConfig(
            resolve("scripted"), "grasp", tmp_path / engine, episodes=300, engine=engine, workers=2
        )
        run_evaluation(config, sink)
        tables.append((tmp_path / engine / "results.parquet").read_bytes())
    assert killer.done and any("was redone" in note for note in killer.notes)
    assert tables[0] == tables[1]


@pytest.mark.slow
def test_a_suite_has_the_same_bytes(fake_home: Path) -> None:
    """What a scenario changes travels with it: the outcomes of the fake world follow from all of it."""
    count = len(write_suite(fake_home / "manifests"))
    for engine, world in (("inline", fake_backend()), ("ray", fake_backend(simulator=CLUSTER_SIMULATOR))):
        config = fake_config(fake_home / engine, version="tough-v1", episodes=count, engine=engine, workers=1)
        run_evaluation(config, backend=world)
    inline, ray = ((fake_home / name / "results.parquet").read_bytes() for name in ("inline", "ray"))
    assert inline == ray


@pytest.mark.slow
def test_a_frozen_suite_has_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    tables = []
    for engine in ("inline", "ray"):
        config = EvaluationConfig(
            resolve("scripted"),
            "grasp",
            tmp_path / engine,
            split="val",
            version="hard-v1",
            episodes=12,
            engine=engine,
            workers=1,
        )
        run_evaluation(config)
        tables.append((tmp_path / engine / "results.parquet").read_bytes())
    assert tables[0] == tables[1]


@pytest.mark.slow
def test_a_collection_has_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("baselines.rounds.collect.call_in_child", lambda target: fake_fingerprint())
    world = fake_backend(simulator=CLUSTER_SIMULATOR)
    found = [
        tree(collect_fake(write_plan(tmp_path), tmp_path / engine, engine, **options).release.path)
        for engine, options in (("inline", {}), ("ray", {"backend": world, "workers": 1}))
    ]
    assert found[0] == found[1]


def test_simulators_that_die_are_replaced_where_they_are(order: Order, tmp_path: Path) -> None:
    order(die_once=[7], die=[30], marks=str(tmp_path), **{"raise": [11]})
    jobs, engine = fake_jobs(60), RayEngine(CLUSTER_SIMULATOR, 1)
    results = collect(engine, jobs)
    assert lost(results) == {11: "raised", 30: "died"}
    assert results[7].attempt == 2
    assert engine.replaced == 0
    right = expected(jobs)
    assert all(outcomes(results)[key] == right[key] for key in right if key not in (11, 30))


@pytest.mark.slow
def test_an_episode_that_costs_two_actors_is_given_up(order: Order) -> None:
    order(lose=[13])
    jobs, engine = fake_jobs(40), RayEngine(CLUSTER_SIMULATOR, 1)
    results = collect(engine, jobs)
    assert lost(results) == {13: "died"}
    assert engine.replaced == 2
    assert {key for key, result in results.items() if result.attempt == 2} == set(range(25))  # its shard, one by one


def test_nothing_outlives_an_abandoned_map(cluster: Any, order: Order) -> None:
    order(delay_s=0.02)
    engine = RayEngine(CLUSTER_SIMULATOR, 1)
    running = engine.map(job_batches(fake_jobs(200)))
    next(running)
    children = simulators(cluster.head_node)
    assert len(children) == 1
    with pytest.raises(KeyboardInterrupt):
        running.throw(KeyboardInterrupt())  # type: ignore[attr-defined]
    assert psutil.wait_procs(children, timeout=20)[1] == []
    engine.close()


def test_a_simulator_that_cannot_be_built(order: Order) -> None:
    order(broken=True)
    with pytest.raises(InfrastructureError, match="cannot be built"):
        collect(RayEngine(CLUSTER_SIMULATOR, 1), fake_jobs(10))


def test_a_machine_that_simulates_differently_is_refused() -> None:
    with pytest.raises(InfrastructureError, match="simulates differently"):
        collect(RayEngine(CLUSTER_SIMULATOR, 1, same=OTHER_MACHINES), fake_jobs(10))


def test_ctrl_c_and_kill_mean_what_they_meant_before() -> None:
    import ray

    ray.shutdown()
    assert worker_count("ray") == 1 and not ray.is_initialized()  # it was asked, and left again
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    engine = RayEngine(CLUSTER_SIMULATOR)
    assert engine.workers == make_engine("ray").workers == 1
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before
    engine.close()
    assert not ray.is_initialized()  # it left what it had joined
    assert len(collect(engine, fake_jobs(5))) == 5  # and joins it again


@pytest.mark.parametrize("address", ["127.0.0.1:1", "auto"])
def test_without_a_cluster(monkeypatch: pytest.MonkeyPatch, address: str) -> None:
    import ray

    ray.shutdown()
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:1")
    with pytest.raises(InputError, match="no Ray cluster at '127.0.0.1:1'"):
        collect(RayEngine(CLUSTER_SIMULATOR, address=address), fake_jobs(1))
