"""Hostile policies end as counted failures or gain nothing; the evaluator survives, and nothing of them stays."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import psutil
import pytest

from evaluator.policy import Answer, PolicyFault, PolicyHost, PolicyLimits, PolicySpec, resolve
from evaluator.policy.wire import batch_frame
from rema_data import grid
from rema_data.errors import PolicyFailureError, SubmissionError
from tests.evaluator.fakes import fake_backend, fake_config
from tests.evaluator.policy import hostile
from tests.evaluator.policy.batches import make_batch, make_situation
from tests.evaluator.policy.conftest import skip_without_sandbox
from tests.evaluator.policy.test_host_answers import reasons

PATIENT = PolicyLimits(start_s=60, batch_s=30, single_s=30)
SMALL = PolicyLimits(start_s=60, batch_s=30, memory_bytes=400 << 20, disk_bytes=48 << 20, disk_files=100)


def policy(name: str) -> PolicySpec:
    return resolve(f"{hostile.__file__}:{name}")


def successes(answers: list[Answer]) -> set[int]:
    """What the hostile policies say of their tries."""
    assert reasons(answers) == ["ok"] * len(answers)
    return {int(grid.decode(int(answer))[2]) for answer in answers}  # type: ignore[arg-type]


@pytest.fixture(autouse=True)
def _nothing_stays(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No process that was not there before, and no file."""
    temporary = tmp_path_factory.mktemp("temporary")
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    processes = {child.pid for child in psutil.Process().children(recursive=True)}
    yield
    assert {child.pid for child in psutil.Process().children(recursive=True)} <= processes
    assert list(temporary.iterdir()) == []


@pytest.fixture(scope="module")
def _sandboxed() -> None:
    with PolicyHost(resolve("random"), None) as host:
        skip_without_sandbox(host)


@pytest.mark.usefixtures("_sandboxed")
@pytest.mark.parametrize(
    ("name", "harmless"),
    [
        ("ReadsScenarios", 1),  # a link of its own that leads nowhere
        ("InspectsEvaluator", 0),
        ("SignalsEvaluator", 0),
        ("OpensSockets", 0),
        ("StartsProcesses", 0),
        ("ChangesFiles", 0),
        ("LiftsLimits", 0),
    ],
)
def test_what_is_denied(name: str, harmless: int, tmp_path: Path) -> None:
    weights = tmp_path / "weights.npz"
    weights.write_bytes(b"weights")
    with PolicyHost(policy(name), weights, "cpu", PATIENT) as host:
        assert successes(host.act(make_batch(3))) == {harmless}
        assert host.restarts == 0
    assert weights.read_bytes() == b"weights"


@pytest.mark.parametrize("name", ["ReadsScenarios", "OpensSockets"])
def test_without_the_sandbox_the_same_policies_succeed(name: str) -> None:
    """So the sandbox denies what is denied above."""
    with PolicyHost(policy(name), None, "cpu", PATIENT, confine=False) as host:
        assert host.isolation.level == "L1"
        assert min(successes(host.act(make_batch(1)))) > 1


@pytest.mark.parametrize(
    ("name", "reason", "words"),
    [
        ("FillsDisk", "died", "filled its temporary folder"),
        ("FillsDiskUnseen", "died", "filled its temporary folder"),
        ("WritesOneFile", "exception", "File too large"),
        ("Allocates", "exception", "MemoryError"),
        ("AllocatesShared", "died", "of memory"),
    ],
)
def test_what_takes_too_much(name: str, reason: str, words: str) -> None:
    with PolicyHost(policy(name), None, "cpu", SMALL) as host:
        (fault,) = host.act(make_batch(1))
        assert isinstance(fault, PolicyFault) and fault.reason == reason
        assert words in fault.detail


def test_many_files_are_too_much(tmp_path: Path) -> None:
    path = tmp_path / "my_policy.py"
    path.write_text(
        "import os, time\nclass Policy:\n    def __init__(self, checkpoint, device):\n"
        "        for n in range(200): os.mkdir(str(n))\n        time.sleep(60)\n    def act(self, observations): ...\n"
    )
    with (
        pytest.raises(SubmissionError, match="more than 100 files"),
        PolicyHost(resolve(str(path)), None, "cpu", SMALL),
    ):
        pass


def test_slow_answers_use_up_the_time_of_the_run() -> None:
    limits = PolicyLimits(start_s=60, batch_s=30, run_s=3.0, observation_s=0.1)
    with PolicyHost(policy("Dawdles"), None, "cpu", limits) as host:
        for _ in range(40):
            answers = host.act(make_batch(2))
        assert reasons(answers) == ["timeout"] * 2
        assert isinstance(answers[0], PolicyFault)
        assert "used up its time: 3 s and 0.1 s for each of" in answers[0].detail
        assert host.restarts == 0


def test_what_it_remembers_is_gone_with_its_process() -> None:
    deadly = make_batch(1)
    deadly.scene[:] = -1
    with PolicyHost(policy("Remembers"), None, "cpu", PATIENT) as host:
        assert [successes(host.act(make_batch(1))) for _ in range(3)] == [{0}, {1}, {2}]
        assert reasons(host.act(deadly)) == ["died"]
        assert successes(host.act(make_batch(1))) == {0}
    with PolicyHost(policy("Remembers"), None, "cpu", PATIENT) as host:
        assert successes(host.act(make_batch(1))) == {0}


@pytest.mark.parametrize("name", ["CountsQuestions", "RemembersObservations"])
def test_answers_by_the_order_of_the_questions_change_with_it(name: str) -> None:
    """The sandbox does not stop them; the order of a run shows that the same question gets another answer."""
    batch = make_batch(4)
    with PolicyHost(policy(name), None, "cpu", PATIENT) as host:
        first, again = host.act(batch), host.act(batch)
    with PolicyHost(policy(name), None, "cpu", PATIENT) as host:
        backwards = [host.act(batch.one(n))[0] for n in reversed(range(4))]
        assert host.restarts == 0
    assert reasons(first) == reasons(again) == ["ok"] * 4
    assert not set(zip(first, range(4), strict=True)) & set(zip(again, range(4), strict=True))
    assert first != backwards[::-1]


def test_privilege_is_not_gained_by_a_restart(tmp_path: Path) -> None:
    notes = tmp_path / "notes"
    notes.write_text("")
    situation = make_situation()
    with PolicyHost(policy("FlipsPrivilege"), notes, "cpu", PATIENT, confine=False) as host:
        assert not host.privileged
        assert reasons(host.act(make_batch(1), (situation,))) == ["died"]
        (answer,) = host.act(make_batch(1), (situation,))
        assert isinstance(answer, PolicyFault) and answer.reason == "restart"
        assert "`privileged` True, at first it had `privileged` False" in answer.detail
        assert not host.privileged


def test_nothing_in_a_question_tells_which_scenario_it_is() -> None:
    """Two questions about the same observation differ in nothing but a number without meaning."""
    batch = make_batch(5)

    def asked(position: int) -> tuple[dict[str, Any], bytes]:
        head, *arrays = (bytes(part) for part in batch_frame(77, batch.one(position), None))
        return json.loads(head[4:]), b"".join(arrays)

    batch.scene[4] = batch.scene[0]
    assert asked(0) == asked(4)
    assert asked(0)[1] != asked(1)[1]
    assert set(asked(0)[0]) == {"op", "number", "arrays", "primitive", "embodiment", "task", "step"}


def test_the_numbers_of_questions_do_not_count(tmp_path: Path) -> None:
    path = tmp_path / "my_policy.py"
    path.write_text(
        "import inspect\nclass Policy:\n    def __init__(self, checkpoint, device): ...\n"
        "    def act(self, observations):\n"
        "        print(inspect.currentframe().f_back.f_locals['header']['number'])\n"
        "        return [[30, 31, 2]] * len(observations)\n"
    )
    with PolicyHost(resolve(str(path)), None) as host:
        for _ in range(6):
            host.act(make_batch(1))
    numbers = [int(line) for line in host.output.split()]
    assert len(numbers) == 6
    assert {after - before for before, after in pairwise(numbers)} != {1}


def test_a_run_survives_and_counts(fake_home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from evaluator.runner import run_evaluation

    limits = PolicyLimits(start_s=60, batch_s=10, single_s=5)
    backend = fake_backend(open_policy=lambda *given: PolicyHost(policy("Erratic"), None, "cpu", limits))
    config = fake_config(fake_home / "run", episodes=64, engine="inline")
    summary = run_evaluation(config, backend=backend).summary
    assert summary["episodes"] == summary["eligible"] == 64
    assert 0 < summary["policy_errors"] <= 6
    assert summary["infra_errors"] == 0


@pytest.mark.parametrize("name", ["FillsDisk", "Allocates", "Dawdles"])
def test_a_run_of_nothing_but_faults_ends_with_each_counted(name: str, fake_home: Path) -> None:
    """Full disk, no memory, no answer: the run says so and stops, and what it recorded is there."""
    from evaluator.runner import run_evaluation

    limits = replace(SMALL, batch_s=0.2, single_s=0.2) if name == "Dawdles" else SMALL
    backend = fake_backend(open_policy=lambda *given: PolicyHost(policy(name), None, "cpu", limits))
    config = fake_config(fake_home / "run", episodes=3, batch_size=1, engine="inline")
    with pytest.raises(PolicyFailureError, match="failed on 3 of 3"):
        run_evaluation(config, backend=backend)
    summary = json.loads((fake_home / "run" / "summary.json").read_text())
    assert summary["eligible"] == summary["policy_errors"] == 3 and summary["infra_errors"] == 0


def test_the_evaluator_reads_neither_code_nor_weights() -> None:
    """It runs a policy without importing it, torch, or the reader of its weights."""
    code = (
        "import sys\nfrom evaluator.policy import PolicyHost, resolve\n"
        "from tests.evaluator.policy.batches import make_batch\n"
        f"with PolicyHost(resolve({str(policy('Remembers').path)!r} + ':Remembers'), None) as host:\n"
        "    host.act(make_batch(1))\n"
        "bad = [name for name in sys.modules if name.split('.')[0] in ('torch', 'safetensors', 'baselines')\n"
        "       or name.endswith('hostile')]\n"
        "sys.exit(str(bad) if bad else 0)"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
