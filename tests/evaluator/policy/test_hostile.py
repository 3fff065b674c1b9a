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

from evaluator.policy import PolicyFault, PolicyHost, PolicyLimits, PolicySpec, digest, resolve
from evaluator.policy.wire import batch_frame
from evaluator.rollout.backend import Backend
from rema_data.errors import PolicyFailureError
from tests.evaluator.fakes import fake_backend, fake_config
from tests.evaluator.policy.batches import make_batch, make_situation
from tests.evaluator.policy.conftest import skip_without_sandbox
from tests.evaluator.policy.hostile import every
from tests.evaluator.policy.hostile.verdicts import PATIENT, SMALL, successes, verdict
from tests.evaluator.policy.test_host_answers import reasons

DEADLY = ("Crashes", "Stops", "HoldsInterpreter", "Babbles", "ClosesPipes")
WITHOUT_KERNEL = ("FillsDisk", "FillsDiskUnlinked", "FillsDiskMapped", "FillsDiskDeep", "FillsDiskUnreadable",
                  "MakesManyFiles", "AllocatesShared")  # fmt: skip


def policy(name: str) -> PolicySpec:
    return resolve(every.place(name))


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
def test_what_is_denied(tmp_path: Path) -> None:
    """Every policy that tries what it must not do, in one process."""
    weights = tmp_path / "weights.npz"
    weights.write_bytes(b"weights")
    other = tmp_path / "other"  # another installation of rema that the environment leads to
    for lists in (other / "manifests", other / "rema_data" / "_manifests"):
        (lists / "scenarios" / "v1").mkdir(parents=True)
        (lists / "scenarios" / "v1" / "manifest.json").write_text("{}")
    (other / ".git").mkdir()
    (other / ".git" / "HEAD").write_text("")
    (other / "rema_data" / "__init__.py").write_text("")
    for folder in (tmp_path, other):
        folder.chmod(0o755)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join([os.environ.get("PYTHONPATH", ""), str(other)]))
        with PolicyHost(resolve(f"{every.__file__}:TriesAll"), weights, "cpu", PATIENT) as host:
            answers = host.act(make_batch(len(every.TRYING)))
            assert host.restarts == 0
    assert reasons(answers) == ["ok"] * len(every.TRYING)
    found = {name: successes(one) for name, one in zip(every.TRYING, answers, strict=True)}
    if "tmpfs" not in host.isolation.to_dict()["up"]["disk"]:  # no mounts of its own: docs/threat_model.md
        found["ReadsToMark"] = 0
    assert found == {name: every.POLICIES[name].harmless for name in every.TRYING}, host.output
    assert weights.read_bytes() == b"weights"


def test_without_the_sandbox_the_same_policies_succeed() -> None:
    """So the sandbox denies what is denied above."""
    with PolicyHost(resolve(f"{every.__file__}:TriesSome"), None, "cpu", PATIENT, confine=False) as host:
        assert host.isolation.level == "L1"
        answers = host.act(make_batch(len(every.ASKING)))
    found = {name: successes(one) for name, one in zip(every.ASKING, answers, strict=True)}
    assert min(found.values()) > 0, found


@pytest.mark.usefixtures("_sandboxed")
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("WritesOneFile", "File too large"),
        ("Allocates", "MemoryError"),
        ("AllocatesShared", "Operation not permitted"),
        ("AllocatesFiles", "Operation not permitted"),
        ("AllocatesPipes", "Operation not permitted"),
        ("StartsManyThreads", "can't start new thread"),
    ],
)
def test_what_takes_too_much(name: str, words: str) -> None:
    with PolicyHost(policy(name), None, "cpu", SMALL) as host:
        (fault,) = host.act(make_batch(1))
        assert isinstance(fault, PolicyFault) and fault.reason == "exception"
        assert words in fault.detail and "sandbox: rule" in fault.detail


@pytest.mark.parametrize("name", WITHOUT_KERNEL)
def test_what_takes_too_much_without_the_kernel(name: str) -> None:
    """Where the kernel keeps no limit, the evaluator looks: nothing can be hidden from it."""
    with PolicyHost(policy(name), None, "cpu", SMALL, confine=False) as host:
        (fault,) = host.act(make_batch(1))
        assert isinstance(fault, PolicyFault) and fault.reason == "died"
        assert "temporary folder" in fault.detail or "of memory" in fault.detail


@pytest.mark.usefixtures("_sandboxed")
@pytest.mark.parametrize("name", ["FillsDisk", "FillsDiskMapped", "FillsDiskDeep", "MakesManyFiles"])
def test_a_full_folder_is_a_fault(name: str) -> None:
    with PolicyHost(policy(name), None, "cpu", SMALL) as host:
        (fault,) = host.act(make_batch(1))
        assert isinstance(fault, PolicyFault)
        if "tmpfs" in host.isolation.to_dict()["up"]["disk"]:
            assert "No space left on device" in fault.detail and "rule disk" in fault.detail
        else:
            assert "temporary folder" in fault.detail


@pytest.mark.parametrize("name", DEADLY)
def test_how_they_end(name: str, tmp_path: Path) -> None:
    found = verdict(name, tmp_path)
    assert found.contained and found.counted, found


@pytest.mark.slow
@pytest.mark.usefixtures("_sandboxed")
@pytest.mark.parametrize("name", every.POLICIES)
def test_every_policy_is_contained_and_counted(name: str, tmp_path: Path) -> None:
    found = verdict(name, tmp_path)
    assert found.contained and found.counted, found


def test_there_are_sixty_policies() -> None:
    assert len(every.POLICIES) >= 60


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
        assert [successes(host.act(make_batch(1))[0]) for _ in range(3)] == [0, 1, 2]
        assert reasons(host.act(deadly)) == ["died"]
        assert successes(host.act(make_batch(1))[0]) == 0
    with PolicyHost(policy("Remembers"), None, "cpu", PATIENT) as host:
        assert successes(host.act(make_batch(1))[0]) == 0


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
    weights = tmp_path / "weights"
    weights.write_text(str(tmp_path / "notes"))
    situation = make_situation()
    with PolicyHost(policy("FlipsPrivilege"), weights, "cpu", PATIENT, confine=False) as host:
        assert not host.privileged
        assert reasons(host.act(make_batch(1), (situation,))) == ["died"]
        (answer,) = host.act(make_batch(1), (situation,))
        assert isinstance(answer, PolicyFault) and answer.reason == "restart"
        assert "`privileged` True, at first it had False" in answer.detail
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


def hosting(spec: PolicySpec, limits: PolicyLimits) -> Backend:
    """The fake world, and a policy in its real process."""
    return fake_backend(
        open_policy=lambda *given: PolicyHost(spec, None, "cpu", limits),
        policy_digest=lambda *given: digest(spec, None),
    )


def test_a_run_survives_and_counts(fake_home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from evaluator.runner import run_evaluation

    limits = PolicyLimits(start_s=60, batch_s=10, single_s=5)
    backend = hosting(policy("Erratic"), limits)
    config = fake_config(fake_home / "run", episodes=64, engine="inline")
    summary = run_evaluation(config, backend=backend).summary
    assert summary["episodes"] == summary["eligible"] == 64
    assert 0 < summary["policy_errors"] <= 6
    assert summary["infra_errors"] == 0


@pytest.mark.parametrize("name", ["FillsDisk", "Allocates", "Dawdles"])
def test_a_run_of_nothing_but_faults_ends_with_each_counted(name: str, fake_home: Path) -> None:
    """Full disk, no memory, no answer: the run says so and stops, and what it recorded is there."""
    from evaluator.runner import run_evaluation

    limits = replace(SMALL, batch_s=0.2, observation_s=0.1, single_s=0.2) if name == "Dawdles" else SMALL
    backend = hosting(policy(name), limits)
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
        f"with PolicyHost(resolve({every.place('Remembers')!r}), None) as host:\n"
        "    host.act(make_batch(1))\n"
        "bad = [name for name in sys.modules if name.split('.')[0] in ('torch', 'safetensors', 'baselines')\n"
        "       or 'hostile' in name]\n"
        "sys.exit(str(bad) if bad else 0)"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
