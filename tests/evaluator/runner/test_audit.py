"""The audit repeats a share of every run, and shows who does not answer or simulate the same again."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from evaluator.leaderboard.eligibility import obstacles
from evaluator.protocol import AUDIT_LEAST
from evaluator.run.reading import read_run
from evaluator.run.records import Ledger
from evaluator.runner import run_evaluation
from evaluator.statistics import clopper_pearson
from rema_data.errors import InputError, PolicyFailureError, SubmissionError
from rema_data.schema import Situation, StepOutcome
from tests.evaluator.fakes import FakePolicyProcess, FakeSimulator, fake_backend, fake_config

LONG = "grasp_grasp_push"


class Recording(FakePolicyProcess):
    """Remembers which observations it was asked about together."""

    def __init__(self) -> None:
        super().__init__()
        self.batches: list[list[str]] = []

    def act(self, batch: Any, situations: tuple[Situation, ...] | None) -> list[Any]:
        self.batches.append([hashlib.sha256(scene.tobytes()).hexdigest() for scene in batch.scene])
        return super().act(batch, situations)


class Positional(FakePolicyProcess):
    """Answers by the row of the batch."""

    def act(self, batch: Any, situations: tuple[Situation, ...] | None) -> list[Any]:
        choices = np.flatnonzero(batch.valid[0])
        return [int(choices[n]) for n in range(len(batch.scene))]


class Remembering(FakePolicyProcess):
    """Answers by the number of observations that it has seen in its life."""

    def act(self, batch: Any, situations: tuple[Situation, ...] | None) -> list[Any]:
        choices = np.flatnonzero(batch.valid[0])
        self.asked += len(batch.scene)
        return [int(choices[self.asked - n]) for n in range(len(batch.scene))]


class Restless(FakeSimulator):
    """A world whose evidence depends on the process it runs in."""

    def run(self, situation: Situation, action: int) -> StepOutcome:
        return replace(super().run(situation, action), peak_force_n=float(os.getpid()))


def audited(output: Path, kind: type[FakePolicyProcess] = FakePolicyProcess, **changes: Any) -> dict[str, Any]:
    """Audit of a run whose policy has a new process each time it is opened."""

    @contextmanager
    def open_policy(*_: Any) -> Iterator[FakePolicyProcess]:
        yield kind()

    backend = {"open_policy": open_policy, "simulator": changes.pop("simulator", fake_backend().simulator)}
    fields = {"engine": "inline", **changes}
    summary = run_evaluation(fake_config(output, **fields), backend=fake_backend(**backend)).summary
    assert json.loads((output / "summary.json").read_text()) == summary
    found: dict[str, Any] = summary["audit"]
    return found


@pytest.mark.parametrize(("share", "expected"), [(0.01, AUDIT_LEAST), (0.5, 150)])
def test_a_pure_policy_in_a_pure_world_has_no_flips(fake_home: Path, share: float, expected: int) -> None:
    audit = audited(fake_home / "run", episodes=300, audit_share=share)
    assert audit["episodes"] == audit["actions"] == audit["outcomes"] == expected
    assert audit["action_flips"] == audit["outcome_flips"] == audit["lost"] == 0 and audit["flipped"] == []
    assert audit["outcome_flips_ci95"] == list(clopper_pearson(0, expected))


def test_every_step_of_an_end_to_end_episode_is_repeated(fake_home: Path) -> None:
    audit = audited(fake_home / "run", task=LONG, protocol="end-to-end", episodes=20)
    ledger = Ledger(fake_home / "run" / "records", 2)
    assert audit["episodes"] == 20
    assert audit["actions"] == len(ledger.answers) > 20
    assert audit["outcomes"] == len(ledger.outcomes)
    assert audit["action_flips"] == audit["outcome_flips"] == 0


@pytest.mark.parametrize("kind", [Positional, Remembering])
def test_a_policy_that_is_no_function_of_the_observation_shows(fake_home: Path, kind: type[FakePolicyProcess]) -> None:
    audit = audited(fake_home / "run", kind, episodes=300)
    assert audit["action_flips"] > audit["actions"] / 2
    assert audit["outcome_flips"] == 0  # the recorded actions are simulated, not the new ones
    assert len(audit["flipped"]) == 10 and audit["flipped"][0]["what"] == "action"


def test_a_policy_that_counts_its_questions_does_not_know_the_scenario(fake_home: Path) -> None:
    """It has a table of actions by the order of the list; two runs ask in two orders, and neither has a rank."""
    actions = []
    for name in ("one", "two"):
        audited(fake_home / name, Remembering, episodes=300)
        run = read_run(fake_home / name)
        assert "actions" in [obstacle.what for obstacle in obstacles(run)]
        actions.append(pq.read_table(fake_home / name / "results.parquet")["step0_action"].to_numpy())
    assert (actions[0] != actions[1]).mean() > 0.9


def test_a_world_that_depends_on_its_process_shows(fake_home: Path) -> None:
    audit = audited(fake_home / "run", episodes=40, simulator="tests.evaluator.runner.test_audit:Restless")
    assert audit["action_flips"] == 0
    assert audit["outcome_flips"] == audit["outcomes"] == AUDIT_LEAST
    assert audit["outcome_flips_ci95"][1] == 1.0


@pytest.mark.parametrize("batch_size", [24, 64])
def test_the_observations_have_other_companions(fake_home: Path, batch_size: int) -> None:
    process = Recording()
    config = fake_config(fake_home / "run", episodes=300, engine="inline", batch_size=batch_size)
    run_evaluation(config, backend=fake_backend(process))
    asked = -(-300 // batch_size)
    first, again = process.batches[:asked], process.batches[asked:]
    home = {scene: number for number, batch in enumerate(first) for scene in batch}
    assert len(again[0]) not in (batch_size, 0)
    for batch in again:
        assert len({home[scene] for scene in batch}) > 1
    order = [home[scene] for batch in again for scene in batch]  # of all: the last batch may be in order by chance
    assert order != sorted(order)


def test_an_interrupted_audit_goes_on_where_it_stopped(fake_home: Path) -> None:
    audited(fake_home / "whole", episodes=100)

    class Impatient:
        auditing = False
        done = 0

        def phase(self, name: str, total: int) -> None:
            self.auditing = name == "audit"

        def advance(self, n: int) -> None:
            self.done += n * self.auditing
            if self.done >= AUDIT_LEAST + 5:
                raise KeyboardInterrupt

        def note(self, text: str) -> None:
            pass

    config = fake_config(fake_home / "run", episodes=100, engine="inline", workers=1)  # one batch of repeats is left
    process = FakePolicyProcess()
    with pytest.raises(KeyboardInterrupt):
        run_evaluation(config, Impatient(), backend=fake_backend(process))
    assert process.asked == 100 + AUDIT_LEAST
    summary = run_evaluation(config, backend=fake_backend(process)).summary
    assert process.asked == 100 + AUDIT_LEAST  # no question twice
    assert summary["audit"]["outcomes"] == AUDIT_LEAST and summary["segments"] == 2
    table = "results.parquet"
    assert (fake_home / "run" / table).read_bytes() == (fake_home / "whole" / table).read_bytes()


def test_a_finished_run_is_not_audited_again(fake_home: Path) -> None:
    config = fake_config(fake_home / "run", episodes=50, engine="inline")
    first = run_evaluation(config, backend=fake_backend())
    header = (fake_home / "run" / "run.json").read_bytes()
    process = FakePolicyProcess()
    assert run_evaluation(config, backend=fake_backend(process)).summary == first.summary
    assert process.asked == 0
    assert (fake_home / "run" / "run.json").read_bytes() == header


def test_a_policy_that_failed_is_not_asked_again(fake_home: Path) -> None:
    process = FakePolicyProcess(faulty=0.5)
    with pytest.raises(PolicyFailureError):
        run_evaluation(fake_config(fake_home / "run", episodes=50, engine="inline"), backend=fake_backend(process))
    assert process.asked == 50
    assert json.loads((fake_home / "run" / "summary.json").read_text())["audit"] is None


def test_faults_that_come_again_are_no_flips(fake_home: Path) -> None:
    process = FakePolicyProcess(faulty=0.05)
    config = fake_config(fake_home / "run", episodes=200, engine="inline", audit_share=1.0)
    audit = run_evaluation(config, backend=fake_backend(process)).summary["audit"]
    assert audit["actions"] == 200 and audit["action_flips"] == 0
    assert audit["outcomes"] < 200 and audit["lost"] == 0


def test_no_audit_where_none_is_wanted(fake_home: Path) -> None:
    config = fake_config(fake_home / "run", episodes=5, engine="inline", audit_share=0.0)
    assert run_evaluation(config, backend=fake_backend()).summary["audit"] is None
    with pytest.raises(InputError, match="audit_share"):
        fake_config(fake_home / "run", audit_share=2.0)


def test_a_policy_that_sees_the_truth_only_now_and_then_is_refused(fake_home: Path) -> None:
    """Blind in the run and privileged in its audit: the row would not say what it is."""
    kinds = iter([False, True])

    @contextmanager
    def open_policy(*_: Any) -> Iterator[FakePolicyProcess]:
        process = FakePolicyProcess()
        process.privileged = next(kinds)
        yield process

    with pytest.raises(SubmissionError, match="earlier in this run it had False"):
        run_evaluation(
            fake_config(fake_home / "run", episodes=40, engine="inline"), backend=fake_backend(open_policy=open_policy)
        )
    assert not (fake_home / "run" / "summary.json").exists()
