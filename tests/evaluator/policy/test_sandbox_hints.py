"""Every failure that the sandbox causes says which rule, which path, and what to do: in the constructor and in act."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from evaluator.policy import PolicyFault, PolicyHost, PolicySpec
from rema_data.errors import SubmissionError
from tests.evaluator.policy.batches import make_batch
from tests.evaluator.policy.conftest import WritePolicy, skip_without_sandbox
from tests.evaluator.policy.test_host_answers import LIMITS

CASES = {
    "module outside": (
        "sys.path.append(os.path.join(os.path.dirname(__file__), '..'))\nimport lying_outside",
        r"rule files: {around}/lying_outside.py is outside of the policy's folder.*move it beside my_policy.py",
    ),
    "package outside": (
        "from packaged_outside import inner",
        r"rule files: {around}/packaged_outside is outside of the policy's folder",
    ),
    "relative import": ("from ..lying_outside import x", r"loaded by itself.*import by the full name of the package"),
    "relative path beside": ("open('beside.npz')", r"rule folder.*write Path\(__file__\).parent / 'beside.npz'"),
    "relative path in a folder": ("open('data/x.npz').read()", r"write Path\(__file__\).parent / 'data/x.npz'"),
    "relative path here": ("np.load('here.npz')", r"rule folder.*name {here}/here.npz with --checkpoint"),
    "variable": ("os.environ['REMA_TEST_TOKEN']", r"rule environment: the variable REMA_TEST_TOKEN is not passed"),
    "variable of a library": ("import shlex; os.environ.pop('REMA_TEST_TOKEN')", r"variable REMA_TEST_TOKEN"),
    "data outside": (
        "open('{around}/data.npz')",
        r"rule files: {around}/data.npz is outside of what a policy may read: copy it into {own}",
    ),
    "folder outside": ("os.listdir('/')", r"rule files: / is outside of what a policy may read"),
    "link outside": (
        "open(os.path.join(os.path.dirname(__file__), 'linked.npz'))",
        r"rule files: {own}/linked.npz is not in the copy.*a link that leads outside.*data.npz",
    ),
    "hidden file": (
        "open(os.path.join(os.path.dirname(__file__), '.secret'))",
        r"rule files: {own}/.secret is not in the copy.*hidden",
    ),
    "writing": (
        "open(os.path.join(os.path.dirname(__file__), 'new.npz'), 'w')",
        r"rule files: {own}/new.npz may not be written: write to a file in tempfile.gettempdir",
    ),
    "writing into itself": ("open(__file__, 'a')", r"rule files: {own}/my_policy.py may not be written"),
    "mode": ("os.chmod(__file__, 0o444)", r"rule attributes: mode, owner and times of {own}/my_policy.py"),
    "times": ("os.utime(__file__)", r"rule calls.*times of files"),
    "process": ("import subprocess; subprocess.run(['true'])", r"rule processes: no process may be started"),
    "pool": ("import multiprocessing; multiprocessing.Process(target=print).start()", r"rule processes"),
    "socket": ("import socket; socket.create_connection(('127.0.0.1', 9))", r"rule network: no connection is allowed"),
    "download": (
        "import urllib.request; urllib.request.urlopen('http://127.0.0.1:9/weights')",
        r"rule network.*--checkpoint",
    ),
    "name of a host": ("import socket; socket.getaddrinfo('example.org', 80)", r"rule network"),
    "lock": ("import fcntl; fcntl.flock(os.open(__file__, os.O_RDONLY), fcntl.LOCK_SH)", r"rule calls"),
    "memory": ("np.ones(1 << 40)", r"rule memory: a policy may use"),
    "size of a file": ("open('x', 'wb').truncate(1 << 42)", r"rule disk: the temporary folder may hold 2.0 GiB"),
    "open files": ("x = [open(__file__) for _ in range(2000)]", r"rule descriptors: 1024 files"),
}
"""What a policy does, and what it is told."""


@pytest.fixture
def places(tmp_path: Path, write_policy: WritePolicy, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """The folders of the cases; the policy is written into ``own``."""
    own, here = tmp_path / "own", tmp_path / "here"
    for folder in (own / "data", here, tmp_path / "packaged_outside"):
        folder.mkdir(parents=True)
    for file in (own / "beside.npz", own / "data" / "x.npz", own / ".secret", here / "here.npz", tmp_path / "data.npz"):
        file.write_text("")
    (tmp_path / "lying_outside.py").write_text("x = 1\n")
    (tmp_path / "packaged_outside" / "__init__.py").write_text("")
    (own / "linked.npz").symlink_to(tmp_path / "data.npz")
    monkeypatch.chdir(here)
    monkeypatch.setenv("REMA_TEST_TOKEN", "x")
    return {"own": str(own), "here": str(here), "around": str(tmp_path)}


@pytest.fixture
def policy(places: dict[str, str], write_policy: WritePolicy) -> Callable[..., PolicySpec]:
    """``policy(act=..., init=...)`` in the folder ``own``."""

    def write(**parts: str) -> PolicySpec:
        written = write_policy(**{"act": "return good", **parts})
        text = written.path.read_text()
        written.path.unlink()
        path = Path(places["own"], "my_policy.py")
        path.write_text(text)
        return PolicySpec(written.name, path, written.class_name)

    return write


def test_in_act_all_of_them(policy: Callable[..., PolicySpec], places: dict[str, str]) -> None:
    """One process tries the case that the observation names."""

    lines = [line.replace("{around}", places["around"]) for line, _ in CASES.values()]
    act = f"exec({lines!r}[round(float(observations.scene[0, 0, 0]))], globals())\nreturn good"
    with PolicyHost(policy(act=act), None, "cpu", LIMITS) as host:
        skip_without_sandbox(host)
        for number, (name, (_, words)) in enumerate(CASES.items()):
            batch = make_batch(1)
            batch.scene[0, 0, 0] = number
            (fault,) = host.act(batch)
            assert isinstance(fault, PolicyFault) and fault.reason == "exception", (name, fault)
            for place, path in places.items():
                words = words.replace(f"{{{place}}}", re.escape(path))
            assert re.search(words, fault.detail), (name, fault.detail)
            assert fault.detail.count("; sandbox: ") == 1 and "rema-copy-" not in fault.detail


@pytest.mark.parametrize(
    "name", ["module outside", "relative import", "relative path here", "variable", "data outside", "link outside"]
)
def test_in_the_constructor(name: str, policy: Callable[..., PolicySpec], places: dict[str, str]) -> None:
    line, words = CASES[name]
    with (
        pytest.raises(SubmissionError) as caught,
        PolicyHost(policy(init=line.replace("{around}", places["around"])), None, "cpu", LIMITS) as host,
    ):
        skip_without_sandbox(host)
    for place, path in places.items():
        words = words.replace(f"{{{place}}}", path)
    hint = [text for text in caught.value.hint.splitlines() if text.startswith("sandbox: ")]
    assert len(hint) == 1

    assert re.search(words, hint[0]), hint


@pytest.mark.parametrize(
    "line",
    ["raise KeyError('HOME')", "import no_such_module_anywhere", "open('/no/such/file')", "raise OSError(5, 'x')"],
)
def test_what_the_sandbox_did_not_cause_is_not_blamed_on_it(line: str, policy: Callable[..., PolicySpec]) -> None:
    with PolicyHost(policy(act=line), None, "cpu", LIMITS) as host:
        (fault,) = host.act(make_batch(1))
    assert isinstance(fault, PolicyFault) and "sandbox:" not in fault.detail


def test_paths_of_the_temporary_folder_are_the_same_in_every_run(policy: Callable[..., PolicySpec]) -> None:
    spec = policy(act="open(os.path.join(os.environ['TMPDIR'], 'absent'))")
    details = []
    for _ in range(2):
        with PolicyHost(spec, None, "cpu", LIMITS) as host:
            (fault,) = host.act(make_batch(1))
            assert isinstance(fault, PolicyFault)
            details.append(fault.detail)
    assert details[0] == details[1] and "$TMPDIR/absent" in details[0]
    assert os.path.basename(str(spec.path)) in details[0]
