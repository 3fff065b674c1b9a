"""Signals stop work between its steps; without a listener they do what Python says."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from rema_data import interrupts


@pytest.fixture(autouse=True)
def python_handler() -> Iterator[None]:
    """Ctrl-C as in a fresh interpreter, also where the tests run in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupt() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def test_without_a_listener_python_decides() -> None:
    interrupts.check()
    with pytest.raises(KeyboardInterrupt) as caught:
        interrupt()
    assert not isinstance(caught.value, interrupts.Interrupted) and not interrupts.requested()


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_listener_stops_at_the_next_look(kind: signal.Signals) -> None:
    before = signal.signal(kind, signal.SIG_DFL) if kind != signal.SIGINT else None
    try:
        with interrupts.listening(), interrupts.listening():
            os.kill(os.getpid(), kind)
            os.kill(os.getpid(), kind)
            assert interrupts.requested()
            with pytest.raises(interrupts.Interrupted) as caught:
                interrupts.check()
        assert caught.value.exit_code == 128 + kind
        interrupts.check()
        assert signal.getsignal(kind) is (signal.default_int_handler if before is None else signal.SIG_DFL)
    finally:
        if before is not None:
            signal.signal(kind, before)


def test_what_is_ignored_stays_ignored() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with interrupts.listening():
        interrupt()
        interrupts.check()


def test_held_postpones_ctrl_c_to_the_next_look_or_the_end() -> None:
    reached: list[str] = []

    def work(look: bool) -> None:
        with interrupts.held():
            interrupt()
            reached.append("after the signal")
            if look:
                interrupts.check()
            reached.append("after the look")

    with pytest.raises(KeyboardInterrupt):
        work(look=True)
    with pytest.raises(KeyboardInterrupt):
        work(look=False)
    assert reached == ["after the signal", "after the signal", "after the look"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_handler_of_the_program_is_left_alone() -> None:
    seen: list[int] = []
    signal.signal(signal.SIGINT, lambda number, frame: seen.append(number))
    with interrupts.held():
        interrupt()
        interrupts.check()
    assert seen == [signal.SIGINT]


def test_threads_do_not_listen() -> None:
    failed: list[BaseException] = []

    def work() -> None:
        try:
            with interrupts.listening(), interrupts.held():
                interrupts.check()
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert failed == []


def test_a_signal_to_a_forked_child_does_not_stop_its_parent() -> None:
    code = (
        "import os, signal, time\nfrom rema_data import interrupts\ninterrupts.listen()\n"
        "reader, writer = os.pipe()\nchild = os.fork()\n"
        "if child == 0: os.write(writer, b'.'); time.sleep(60)\n"
        "os.read(reader, 1)\n"
        "os.kill(child, signal.SIGINT); os.kill(child, signal.SIGTERM)\n"
        "assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGTERM\n"
        "time.sleep(0.1); interrupts.check()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_foreign_code_that_never_returns_is_ended() -> None:
    """A signal counts although the main thread reaches no handler."""
    code = (
        "import hashlib, os, signal, threading\nfrom rema_data import interrupts\ninterrupts.GRACE_S = 0.2\n"
        "interrupts.listen()\n"
        "threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM)).start()\n"
        "hashlib.pbkdf2_hmac('sha256', b'', b'', 2**31 - 1)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 143 and "interrupted" in done.stderr
