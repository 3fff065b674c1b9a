"""The level that is recorded: never above what the process tried and found denied."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluator.policy import PolicyHost, PolicyLimits, resolve
from evaluator.policy.sandbox.isolation import KERNEL_RESTRICTIONS, NAMESPACES, isolation_of
from evaluator.policy.sandbox.wrapper import check_sandbox, wrapped
from rema_data.errors import InputError
from rema_data.manifests import manifests_dir
from tests.evaluator.policy.batches import make_batch
from tests.evaluator.policy.conftest import WritePolicy, sandbox_is_possible, skip_without_sandbox
from tests.evaluator.policy.test_host_answers import LIMITS, reasons

IMPATIENT = PolicyLimits(start_s=120, batch_s=0.5, observation_s=0.1)
FOREIGN = {kind: f"{kind}:[1]" for kind in NAMESPACES}
WRAPPERS = {
    "bwrap": "bwrap --unshare-all --die-with-parent --ro-bind / / --tmpfs {manifests} --bind {tmp} {tmp} "
    "--proc /proc --dev /dev --",
    "podman": "podman run --rm -i --network none --env-host --workdir {tmp} --volume {tmp}:{tmp} "
    "--mount type=tmpfs,destination={manifests},notmpcopyup --rootfs /:O",
}
"""The commands of docs/threat_model.md."""
NOTHING = {"bwrap": "bwrap --ro-bind / / true", "podman": "podman run --rm --network none --rootfs /:O true"}
"""What each can do where it is installed and allowed to do its work."""


@given(
    up=st.sets(st.sampled_from(KERNEL_RESTRICTIONS)),
    foreign=st.sets(st.sampled_from(NAMESPACES)),
    sandbox=st.sampled_from([None, "bwrap"]),
)
def test_the_level_follows_from_the_restrictions(up: set[str], foreign: set[str], sandbox: str | None) -> None:
    restrictions = [[name, name in up, "so it is"] for name in KERNEL_RESTRICTIONS]
    namespaces = {
        kind: FOREIGN[kind] if kind in foreign else os.readlink(f"/proc/self/ns/{kind}") for kind in NAMESPACES
    }
    found = isolation_of({"restrictions": restrictions, "namespaces": namespaces}, sandbox)
    if up != set(KERNEL_RESTRICTIONS):
        assert found.level == "L1"
    else:
        assert found.level == ("L3" if sandbox and foreign == set(NAMESPACES) else "L2")
    stored = json.loads(json.dumps(found.to_dict()))
    assert set(stored["up"]) == {"process", *up} | ({"namespaces"} if "namespaces" in stored["up"] else set())
    assert set(stored["up"]).isdisjoint(stored["down"]) and all(stored["down"].values())
    assert found.level in str(found)


@pytest.mark.parametrize(
    ("library", "down", "word"),
    [
        ("landlockpy", {"files"}, "landlockpy is not installed"),
        ("pyseccomp", {"network", "processes", "clock", "scheduling", "supervision"}, "pyseccomp is not installed"),
    ],
)
def test_without_a_library_its_restrictions_are_down_and_the_policy_runs(
    library: str, down: set[str], word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / f"{library}.py").write_text(f"raise ImportError('absent', name={library!r})")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with PolicyHost(resolve("random"), None, "cpu", LIMITS) as host:
        stored = host.isolation.to_dict()
        assert stored["level"] == "L1"
        assert down <= set(stored["down"])
        assert all(word in stored["down"][name] for name in down)
        assert reasons(host.act(make_batch(2))) == ["ok", "ok"]


def test_a_sandbox_that_was_not_asked_for(write_policy: WritePolicy) -> None:
    with pytest.raises(InputError, match="not known before"):
        _ = PolicyHost(write_policy("return good"), None).isolation
    with PolicyHost(write_policy("return good"), None, "cpu", LIMITS, confine=False) as host:
        assert host.isolation.level == "L1"
        assert set(host.isolation.to_dict()["down"]) == {*KERNEL_RESTRICTIONS, "namespaces"}
        assert {"process", "memory", "disk", "descriptors"} == set(host.isolation.to_dict()["up"])


def test_root_is_given_up(write_policy: WritePolicy) -> None:
    """No capability stays, and not the user either where the machine's root starts a policy."""
    spec = write_policy(
        "print(os.getuid(), [line for line in open('/proc/self/status') if line.startswith('Cap')])\nreturn good"
    )
    with PolicyHost(spec, None, "cpu", LIMITS) as host:
        skip_without_sandbox(host)
        assert reasons(host.act(make_batch(1))) == ["ok"]
        assert "no capabilities" in host.isolation.to_dict()["up"]["privileges"]
    user, _, capabilities = host.output.partition(" ")
    assert (int(user) == os.getuid()) == (os.getuid() != 0)
    assert capabilities.count("0" * 16) >= 4


def test_a_wrapper_that_wraps_nothing_raises_no_level() -> None:
    with PolicyHost(resolve("random"), None, "cpu", LIMITS, sandbox="env REMA_WRAPPED=1") as host:
        stored = host.isolation.to_dict()
        assert stored["level"] != "L3"
        assert "shares with the evaluator" in stored["down"]["namespaces"]
        assert stored["sandbox"] == "env REMA_WRAPPED=1"
        assert reasons(host.act(make_batch(1))) == ["ok"]


@pytest.fixture(params=WRAPPERS)
def wrapper(request: pytest.FixtureRequest) -> str:
    """The command of a wrapper that works on this machine."""
    name = str(request.param)
    if shutil.which(name) is None:
        pytest.skip(f"{name} is not installed")
    tried = subprocess.run(NOTHING[name].split(), capture_output=True, text=True, check=False, timeout=60)
    if tried.returncode:
        pytest.skip(f"{name} does nothing on this machine: {tried.stderr.strip()}")
    return WRAPPERS[name]


def test_a_wrapper_with_namespaces_of_its_own(wrapper: str, write_policy: WritePolicy) -> None:
    lists = str(manifests_dir() / "scenarios")
    spec = write_policy(f"good[:, 2] = os.path.exists({lists!r}) + 2 * (os.getpid() > 100)\nreturn good")
    with PolicyHost(spec, None, "cpu", LIMITS, sandbox=wrapper) as host:
        stored = host.isolation.to_dict()
        assert stored["level"] == ("L3" if sandbox_is_possible() else "L1")
        assert stored["up"].get("namespaces") == "mnt, net, pid"
        answers = host.act(make_batch(1))
        assert all(isinstance(answer, int) and answer % 16 == 0 for answer in answers)


def test_a_policy_that_hangs_in_a_wrapper_ends_with_it(
    wrapper: str, write_policy: WritePolicy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def inside() -> list[str]:
        """Processes whose temporary folder is the policy's."""
        return [
            process.info["name"]
            for process in psutil.process_iter(["name", "environ"])
            if (process.info["environ"] or {}).get("TMPDIR", "").startswith(str(tmp_path))
        ]

    with PolicyHost(write_policy("time.sleep(600)"), None, "cpu", IMPATIENT, sandbox=wrapper) as host:
        assert inside()
        assert reasons(host.act(make_batch(1))) == ["timeout"]
    deadline = time.monotonic() + 120
    while inside():
        assert time.monotonic() < deadline, inside()
        time.sleep(0.1)


def test_a_wrapper_in_which_nothing_runs() -> None:
    with (
        pytest.raises(InputError, match="Python did not start in --sandbox") as caught,
        PolicyHost(resolve("random"), None, "cpu", LIMITS, sandbox="ls /no-such-folder --"),
    ):
        pass
    assert "no-such-folder" in caught.value.hint


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("", "names no command"),
        ("bwrap 'x", "cannot be split into words"),
        ("env {secrets}", r"unknown place \{secrets\}"),
        ("no-such-wrapper --", "no program 'no-such-wrapper'"),
    ],
)
def test_wrappers_that_cannot_be_used(command: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        PolicyHost(resolve("random"), None, sandbox=command)


def test_places_are_filled_in() -> None:
    words = check_sandbox("env A={tmp} '{policy}/a b' --")
    places = {"tmp": Path("/t"), "policy": Path("/p")}
    assert wrapped(words, places, ["python"]) == ["env", "A=/t", "/p/a b", "--", "python"]
    assert check_sandbox(None) == []
