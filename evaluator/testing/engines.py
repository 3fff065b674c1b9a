"""What an engine must keep, as pytest mixins: supply ``make_engine`` and inherit the tests.

::

    from evaluator.testing.engines import IsolatedEngineContract

    class TestMyEngine(IsolatedEngineContract):
        def make_engine(self, factory, episode_limit_s):
            return MyEngine(factory, 2, episode_limit_s=episode_limit_s)
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import closing

from evaluator.engines import Engine, InfraError, Job, JobBatch, JobResult
from rema_data.schema import Failure, ObjectSpec, Placement, Shape, Situation, StepOutcome

__all__ = ["CRASH", "HANG", "RAISE", "EngineContract", "ExampleSimulator", "IsolatedEngineContract", "example_jobs"]

FACTORY = "evaluator.testing.engines:ExampleSimulator"
RAISE, CRASH, HANG = 65_533, 65_534, 65_535
"""Actions in which the simulator raises, kills its process, or never returns."""
_BATCH = 7


class ExampleSimulator:
    """A simulator whose outcome is a plain function of situation and action."""

    def run(self, situation: Situation, action: int) -> StepOutcome:
        """Outcome of one action, or a fault; see ``RAISE``."""
        if action == RAISE:
            raise ValueError("this action raises")
        if action == CRASH:
            os.kill(os.getpid(), signal.SIGKILL)
        if action == HANG:
            time.sleep(3600)
        if action % 3 == 0:
            return StepOutcome(False, Failure.MISSED, arm="left", sim_steps=action)
        return StepOutcome(
            True, None, arm="right", displacement_m=situation.target.x_m, lift_m=action / 7, sim_steps=action
        )

    def close(self) -> None:
        """Nothing to release."""


def example_jobs(count: int, faults: dict[int, int] | None = None) -> list[Job]:
    """Jobs with the keys 0 to ``count`` - 1; ``faults`` gives some of them a faulty action by key."""
    spec = ObjectSpec(Shape.I, 0.1, 0.02, 0.0, 0.03)
    return [
        Job(key, Situation("grasp", 0, Placement(spec, key * 1e-3, 0.0, 0.1)), (faults or {}).get(key, key))
        for key in range(count)
    ]


def _batches(jobs: Sequence[Job]) -> Iterator[JobBatch]:
    for start in range(0, len(jobs), _BATCH):
        yield tuple(jobs[start : start + _BATCH])


class EngineContract:
    """Every engine: one result for every job, with the outcome that the simulator gives."""

    def make_engine(self, factory: str, episode_limit_s: float) -> Engine:
        """The engine under test, with more than one worker where it can have that.

        Parameters
        ----------
        factory : str
            ``module:attribute`` of the simulator's factory.
        episode_limit_s : float
            After so many seconds without a result from a simulator it counts as hung.
        """
        raise NotImplementedError("supply make_engine")

    def results(self, jobs: Sequence[Job], episode_limit_s: float = 120.0) -> dict[int, JobResult]:
        """Results by key, after a check that every key came once."""
        with closing(self.make_engine(FACTORY, episode_limit_s)) as engine:
            return self._results(engine, jobs)

    def _results(self, engine: Engine, jobs: Sequence[Job]) -> dict[int, JobResult]:
        found = [result for part in engine.map(_batches(jobs)) for result in part]
        assert sorted(result.key for result in found) == [job.key for job in jobs]
        return {result.key: result for result in found}

    def check(self, results: dict[int, JobResult], jobs: Sequence[Job], lost: dict[int, str]) -> None:
        """Assert that the jobs ``lost`` (key to reason) have no outcome, and all others that of the simulator."""
        simulator = ExampleSimulator()
        reasons = {key: one.outcome.reason for key, one in results.items() if isinstance(one.outcome, InfraError)}
        assert reasons == lost
        for job in jobs:
            if job.key not in lost:
                assert results[job.key].outcome == simulator.run(job.situation, job.action)
                assert results[job.key].seconds >= 0

    def test_every_job_has_the_outcome_of_the_simulator(self) -> None:
        """Once, and in the first attempt."""
        jobs = example_jobs(60)
        results = self.results(jobs)
        self.check(results, jobs, {})
        assert {result.attempt for result in results.values()} == {1}

    def test_nothing_to_do(self) -> None:
        """No jobs, no results."""
        assert self.results([]) == {}

    def test_an_empty_batch_means_ask_again(self) -> None:
        """Jobs may depend on earlier results."""
        jobs, seen = example_jobs(20), list[int]()

        def source() -> Iterator[JobBatch]:
            yield tuple(jobs[:5])
            while len(seen) < 5:
                yield ()
            yield tuple(jobs[5:])

        with closing(self.make_engine(FACTORY, 120.0)) as engine:
            for part in engine.map(source()):
                seen.extend(result.key for result in part)
        assert sorted(seen) == list(range(20))

    def test_a_simulator_that_raises_costs_its_job_alone(self) -> None:
        """After a second attempt."""
        jobs = example_jobs(30, {11: RAISE})
        results = self.results(jobs)
        self.check(results, jobs, {11: "raised"})
        assert results[11].attempt == 2 and "this action raises" in str(results[11].outcome)

    def test_it_can_be_used_again(self) -> None:
        """After ``map`` and after ``close``."""
        engine, jobs = self.make_engine(FACTORY, 120.0), example_jobs(15)
        for pause in (False, True, False):
            self.check(self._results(engine, jobs), jobs, {})
            if pause:
                engine.close()
        engine.close()
        assert engine.workers >= 1

    def test_an_interrupted_map_leaves_nothing_behind(self) -> None:
        """Neither results nor jobs of it come back in the next one."""
        with closing(self.make_engine(FACTORY, 120.0)) as engine:
            running = engine.map(_batches(example_jobs(60)))
            next(running)
            try:
                running.throw(KeyboardInterrupt())  # type: ignore[attr-defined]
            except KeyboardInterrupt:
                pass
            else:
                raise AssertionError("the interrupt was lost")
            jobs = example_jobs(10)
            self.check(self._results(engine, jobs), jobs, {})


class IsolatedEngineContract(EngineContract):
    """An engine whose simulators may crash or hang without harm to the process that uses it."""

    def test_a_simulator_that_crashes_costs_its_job_alone(self) -> None:
        """After a second attempt in a fresh process."""
        jobs = example_jobs(30, {3: CRASH, 20: CRASH})
        results = self.results(jobs)
        self.check(results, jobs, {3: "died", 20: "died"})
        assert results[3].attempt == results[20].attempt == 2

    def test_a_simulator_that_hangs_is_stopped(self) -> None:
        """After the limit of an episode, which does not bound the time to start."""
        jobs = example_jobs(30, {5: HANG})
        self.check(self.results(jobs, episode_limit_s=3.0), jobs, {5: "hung"})
