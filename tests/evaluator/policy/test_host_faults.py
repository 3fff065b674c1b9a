"""Policies that raise, hang, die, print without end or write unasked."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from evaluator.policy import PolicyFault, PolicyHost, PolicyLimits, resolve
from rema_data.errors import InputError, MissingFileError, SubmissionError

from .batches import make_batch
from .conftest import REPLIES, WritePolicy
from .test_host_answers import LIMITS, reasons

IMPATIENT = PolicyLimits(start_s=120, batch_s=0.5, observation_s=0.1)


def test_a_file_that_does_not_import(write_policy: WritePolicy) -> None:
    spec = write_policy("return good", top="import no_such_library_at_all")
    with pytest.raises(SubmissionError) as caught, PolicyHost(spec, None):
        pass
    assert "no_such_library_at_all" in caught.value.message
    assert f"{spec.path}:3" in caught.value.message
    assert "Traceback" in caught.value.hint
    assert caught.value.exit_code == 3


def test_a_syntax_error_names_its_line(write_policy: WritePolicy) -> None:
    spec = write_policy("return (")
    with pytest.raises(SubmissionError, match=r"my_policy\.py:10"), PolicyHost(spec, None):
        pass


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("class Other:\n    def act(self, o): pass\n", "has no class Policy; it defines Other"),
        ("class Policy: pass\n", "has no method act"),
        ("x = 1\n", "it defines no class"),
        ("raise SystemExit(3)\n", "SystemExit"),
        ("import os\nos._exit(5)\n", "exit code 5 while it started"),
        ("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n", "SIGSEGV"),
    ],
)
def test_a_file_that_holds_no_policy(tmp_path: Path, code: str, words: str) -> None:
    path = tmp_path / "my_policy.py"
    path.write_text(code)
    with pytest.raises(SubmissionError, match=words), PolicyHost(resolve(str(path)), None):
        pass


def test_a_constructor_that_raises_or_hangs(write_policy: WritePolicy) -> None:
    spec = write_policy("return good", init="raise RuntimeError('no weights: ' + str(checkpoint))")
    with pytest.raises(SubmissionError, match="no weights: None") as caught, PolicyHost(spec, None):
        pass
    assert caught.value.facts["where"] == f"{spec.path}:6"
    spec = write_policy("return good", init="time.sleep(60)")
    with pytest.raises(SubmissionError, match=r"did not start within 1 s"):
        PolicyHost(spec, None, "cpu", PolicyLimits(start_s=1)).__enter__()


def test_a_missing_checkpoint(write_policy: WritePolicy, tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match=r"none\.pt"):
        PolicyHost(write_policy("return good"), tmp_path / "none.pt")


def test_one_raising_observation_is_one_fault(write_policy: WritePolicy) -> None:
    spec = write_policy(
        "if (observations.scene[:, 0, 0] == np.float32(2e-4)).any(): raise ValueError('two')\nreturn good"
    )
    with PolicyHost(spec, None, "cpu", LIMITS) as host:
        answers = host.act(make_batch(5))
        assert reasons(answers) == ["ok", "ok", "exception", "ok", "ok"]
        fault = answers[2]
        assert isinstance(fault, PolicyFault)
        assert "ValueError: two" in fault.detail and "my_policy.py:10" in fault.detail


def test_a_policy_that_always_raises_is_asked_twice_about_everything(write_policy: WritePolicy, tmp_path: Path) -> None:
    calls = tmp_path / "calls"
    spec = write_policy(f"open({str(calls)!r}, 'a').write('x')\nraise KeyError('always')")
    with PolicyHost(spec, None, "cpu", LIMITS, confine=False) as host:
        for _ in range(6):
            assert reasons(host.act(make_batch(4))) == ["exception"] * 4
    assert len(calls.read_text()) == 6 * (1 + 4)


def test_faults_do_not_depend_on_the_batches_before(write_policy: WritePolicy) -> None:
    """So it does not depend on where a run was interrupted, either."""
    spec = write_policy("if n > 1: os._exit(7)\nreturn good")
    with PolicyHost(spec, None, "cpu", LIMITS) as host:
        assert [reasons(host.act(make_batch(2, seed=seed))) for seed in range(5)] == [["ok", "ok"]] * 5
        assert host.restarts == 5


def test_a_policy_that_raises_in_every_batch_has_one_fault_in_each(write_policy: WritePolicy) -> None:
    spec = write_policy("if (observations.scene[:, 0, 0] == 0).any(): raise ValueError\nreturn good")
    with PolicyHost(spec, None, "cpu", LIMITS) as host:
        for _ in range(6):
            assert reasons(host.act(make_batch(3))) == ["exception", "ok", "ok"]


def test_a_hanging_observation_is_one_fault(write_policy: WritePolicy) -> None:
    spec = write_policy("if (observations.scene[:, 0, 0] == np.float32(1e-4)).any(): time.sleep(60)\nreturn good")
    with PolicyHost(spec, None, "cpu", PolicyLimits(batch_s=3, observation_s=1)) as host:
        assert reasons(host.act(make_batch(3))) == ["ok", "timeout", "ok"]
        assert host.restarts == 2


def test_a_large_batch_has_more_time(write_policy: WritePolicy) -> None:
    spec = write_policy("time.sleep(1)\nreturn good")
    with PolicyHost(spec, None, "cpu", PolicyLimits(batch_s=0.5, observation_s=1)) as host:
        assert reasons(host.act(make_batch(20))) == ["ok"] * 20 and host.restarts == 0


def test_a_policy_that_dies(write_policy: WritePolicy) -> None:
    spec = write_policy("if n > 1: os._exit(7)\nif observations.scene[0, 0, 0] == 0: os.abort()\nreturn good")
    with PolicyHost(spec, None, "cpu", LIMITS) as host:
        answers = host.act(make_batch(2))
        assert reasons(answers) == ["died", "ok"]
        assert isinstance(answers[0], PolicyFault)
        assert "SIGABRT" in answers[0].detail


def test_a_signal_without_a_name_is_a_fault_too(write_policy: WritePolicy) -> None:
    with PolicyHost(write_policy("os.kill(os.getpid(), 40)\ntime.sleep(60)"), None, "cpu", LIMITS) as host:
        (answer,) = host.act(make_batch(1))
        assert isinstance(answer, PolicyFault) and answer.reason == "died"
        assert "signal SIGRTMIN+" in answer.detail


def test_a_policy_that_always_dies_is_bounded(write_policy: WritePolicy) -> None:
    with PolicyHost(write_policy("os._exit(7)"), None, "cpu", LIMITS) as host:
        assert reasons(host.act(make_batch(64))) == ["died"] * 64
        assert host.restarts == 3


def test_a_policy_that_cannot_be_started_again(write_policy: WritePolicy, tmp_path: Path) -> None:
    flag = str(tmp_path / "flag")
    spec = write_policy("os._exit(1)", init=f"assert not os.path.exists({flag!r})\nopen({flag!r}, 'w')")
    with PolicyHost(spec, None, "cpu", LIMITS, confine=False) as host:
        assert reasons(host.act(make_batch(2))) == ["restart"] * 2


def test_a_process_that_it_started_does_not_outlive_it(write_policy: WritePolicy, tmp_path: Path) -> None:
    pid_file = tmp_path / "pid"
    spec = write_policy(
        "time.sleep(60)",
        init=f"import subprocess as s; open({str(pid_file)!r}, 'a').write(str(s.Popen(['sleep', '300']).pid) + ' ')",
    )
    with PolicyHost(spec, None, "cpu", IMPATIENT, confine=False) as host:
        host.act(make_batch(1))
    deadline = time.monotonic() + 120
    for pid in pid_file.read_text().split():
        while psutil.pid_exists(int(pid)) and psutil.Process(int(pid)).status() != psutil.STATUS_ZOMBIE:
            assert time.monotonic() < deadline
            time.sleep(0.02)


def test_it_dies_with_the_evaluator(write_policy: WritePolicy, tmp_path: Path) -> None:
    pid_file = tmp_path / "pid"
    spec = write_policy("time.sleep(60)", init=f"open({str(pid_file)!r}, 'w').write(str(os.getpid()))")
    code = (
        "from evaluator.policy import PolicyHost, resolve\nimport time\n"
        f"with PolicyHost(resolve({str(spec.path)!r}), None, confine=False): time.sleep(60)"
    )
    evaluator = subprocess.Popen([sys.executable, "-c", code])
    deadline = time.monotonic() + 120
    while not (pid_file.exists() and pid_file.read_text()) and time.monotonic() < deadline:
        time.sleep(0.02)
    os.kill(evaluator.pid, signal.SIGKILL)
    evaluator.wait()
    pid = int(pid_file.read_text())
    while psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_gigabyte_of_prints(write_policy: WritePolicy, tmp_path: Path) -> None:
    spec = write_policy(
        "line = 'x' * 99 + '\\n'\nfor _ in range(100): sys.stdout.write(line * 100_000)\nprint('the end')\nreturn good",
        init="print('the beginning')",
    )
    log = tmp_path / "policy.log"
    with PolicyHost(spec, None, "cpu", PolicyLimits(batch_s=120), log=log) as host:
        assert reasons(host.act(make_batch(2))) == ["ok", "ok"]
    text = log.read_text()
    (left_out,) = re.findall(r"(\d+) bytes left out", text)
    kept = len(text) - len(f"\n... {left_out} bytes left out ...\n")
    assert kept + int(left_out) == 10**9 + len("the beginning\nthe end\n")
    assert text.startswith("the beginning") and text.endswith("the end\n") and "bytes left out" in text
    assert len(text) < 330 << 10


def test_prints_without_end_from_a_thread_while_it_answers(write_policy: WritePolicy) -> None:
    spec = write_policy(
        "return good",
        init="import threading\nspam = lambda: [os.write(1, b'y' * 65536) for _ in iter(int, 1)]\n"
        "threading.Thread(target=spam, daemon=True).start()",
    )
    with PolicyHost(spec, None, "cpu", PolicyLimits(batch_s=20)) as host:
        for _ in range(3):
            assert reasons(host.act(make_batch(4))) == ["ok"] * 4


@pytest.mark.parametrize(
    "noise", ["b'hello evaluator' * 9", "bytes(4)", "b'\\x00\\x00\\x00\\x02{}'", "b'\\xff' * 70000"]
)
def test_writing_to_the_pipe_of_the_replies(write_policy: WritePolicy, noise: str) -> None:
    spec = write_policy(f"if n > 1: os.write(replies(), {noise})\nreturn good", top=REPLIES)
    with PolicyHost(spec, None, "cpu", LIMITS) as host:
        assert reasons(host.act(make_batch(2))) == ["ok", "ok"]
        assert host.restarts == 1


def test_a_forged_extra_reply_is_not_taken_for_the_next_answer(write_policy: WritePolicy) -> None:
    spec = write_policy(
        """
        from evaluator.policy.wire import frame_parts
        frame = inspect.currentframe().f_back.f_locals["header"]  # the number of the question
        reply = {"op": "acted", "number": frame["number"], "ok": True}
        for part in frame_parts(reply, {"answer": (good, 1)}) if n > 1 else ():
            os.write(replies(), part)
        return good * 0 if n > 1 else good
        """,
        top=f"import inspect\n{REPLIES}",
    )
    with PolicyHost(spec, None, "cpu", LIMITS) as host:
        host.act(make_batch(2))
        assert reasons(host.act(make_batch(1))) == ["protocol"]
        assert reasons(host.act(make_batch(1))) == ["ok"]


@pytest.mark.parametrize(
    ("reference", "error", "words"),
    [
        ("nobody", InputError, r"an installed policy:\n  random .*\n  reference "),
        ("nothing.py", MissingFileError, r"nothing\.py does not exist"),
        ("nothing.py:not a class", InputError, "is not a class name"),
    ],
)
def test_references_that_mean_nothing(reference: str, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        resolve(reference)
