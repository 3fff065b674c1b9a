"""Nothing that a policy started outlives its evaluator, and neither does its folder."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil
import pytest

import evaluator.policy.process
from evaluator.policy import PolicyHost
from evaluator.policy.output import CappedOutput
from evaluator.policy.process import ChildProcess
from evaluator.policy.sandbox.cleanup import remove_folder
from evaluator.policy.sandbox.launch_spec import LaunchSpec
from evaluator.policy.sandbox.snapshot import take_snapshot
from evaluator.policy.wire import frame_parts
from tests.evaluator.policy.batches import make_batch
from tests.evaluator.policy.conftest import WritePolicy

FAMILY = """
import subprocess
subprocess.Popen(["sleep", MARK])
subprocess.Popen(["sleep", MARK], start_new_session=True)
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        os.execve("/bin/sleep", ["sleep", MARK], {})  # nothing tells where it comes from
    os._exit(0)
return good
"""


def sleepers(mark: str) -> list[psutil.Process]:
    return [
        process
        for process in psutil.process_iter(["cmdline", "status"])
        if process.info["cmdline"] == ["sleep", mark] and process.info["status"] != psutil.STATUS_ZOMBIE
    ]


def wait_until(seconds: float, condition: object) -> bool:
    deadline = time.monotonic() + seconds
    while not condition():  # type: ignore[operator]
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def test_processes_that_left_the_group_end_with_the_policy(write_policy: WritePolicy) -> None:
    mark = f"60{os.getpid()}"
    spec = write_policy(FAMILY, top=f"MARK = {mark!r}")
    with PolicyHost(spec, None, confine=False) as host:
        host.act(make_batch(1))
        assert wait_until(120, lambda: len(sleepers(mark)) == 3)
    assert wait_until(120, lambda: not sleepers(mark))


def test_a_killed_evaluator_leaves_neither_processes_nor_folders(
    write_policy: WritePolicy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mark = f"61{os.getpid()}"
    spec = write_policy(f"import subprocess\nsubprocess.Popen(['sleep', {mark!r}])\ntime.sleep(50)\nreturn good")
    (tmp_path / "tmp").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    code = (
        "from evaluator.policy import PolicyHost, resolve\n"
        "from tests.evaluator.policy.batches import make_batch\n"
        f"PolicyHost(resolve({str(spec.path)!r}), None, confine=False).__enter__().act(make_batch(1))"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}
    with subprocess.Popen([sys.executable, "-c", code], env=environment) as evaluator:
        assert wait_until(120, lambda: sleepers(mark))
        assert list((tmp_path / "tmp").glob("rema-policy-*"))
        evaluator.kill()
    assert wait_until(120, lambda: not sleepers(mark))
    assert wait_until(120, lambda: not list((tmp_path / "tmp").glob("rema-policy-*")))


def test_no_cleanup_shell_and_no_folder_stays(write_policy: WritePolicy) -> None:
    spec = write_policy("return good")
    before = {child.pid for child in psutil.Process().children()}
    descriptors = psutil.Process().num_fds()
    for _ in range(3):
        with PolicyHost(spec, None) as host:
            host.act(make_batch(1))
            folders = {child.environ().get("TMPDIR") for child in psutil.Process().children()}
    assert {child.pid for child in psutil.Process().children()} <= before
    assert psutil.Process().num_fds() == descriptors
    own = [Path(str(folder)) for folder in folders if "rema-policy-" in str(folder)]
    assert own and not any(folder.exists() for folder in own)
    assert own[0].parent == Path(tempfile.gettempdir())


def test_a_folder_nested_without_end_is_removed(tmp_path: Path) -> None:
    folder = tmp_path / "deep"
    folder.mkdir()
    here = os.getcwd()
    os.chdir(folder)
    try:
        for _ in range(1500):  # deeper than a path may be long
            os.mkdir("deeper")
            os.chdir("deeper")
        os.chmod(".", 0)
    finally:
        os.chdir(here)
    remove_folder(folder)
    assert not folder.exists()


def test_time_while_the_evaluator_is_suspended_does_not_count(
    write_policy: WritePolicy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, leap = time.monotonic, [0.0]

    def leaping() -> float:
        leap[0] += 1000.0  # as if Ctrl-Z and `fg` came between any two looks at the clock
        return clock() + leap[0]

    output = CappedOutput(None, 1000, 1000)
    spec = write_policy("return good")
    launch = LaunchSpec(take_snapshot(spec, None, tmp_path / "copy"))
    child = ChildProcess(output, launch)
    order = {"op": "load", "path": str(launch.snapshot.policy), "import_root": None, "class_name": "Policy"}
    monkeypatch.setattr(evaluator.policy.process.time, "monotonic", leaping)
    try:
        child.ask(frame_parts(launch.orders(child.folder)), 50.0, 0)
        header, _ = child.ask(frame_parts({**order, "checkpoint": None, "device": "cpu"}), 50.0, 0)
        assert header["ok"] is True
    finally:
        monkeypatch.undo()
        child.close()
        output.settle()
