"""Signals that stop work: they set a flag, and the work looks at it between its steps.

An exception that is raised wherever a signal happens to arrive lands inside callbacks of HDF5 and similar libraries:
they lose it, go on with half a write, or crash. So the command line listens (``listen``), and every loop that can take
long calls ``check`` between two steps. A process that does not end within ``GRACE_S`` is ended; whatever it was writing
has no name yet, and the next run removes it.

Without a listener the Python rule holds: SIGINT raises KeyboardInterrupt. ``held`` postpones that to the next
``check``.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, NoReturn

__all__ = ["GRACE_S", "POLL_S", "Interrupted", "check", "held", "leave", "listen", "listening", "requested"]

GRACE_S = 3.0
"""So long a process has to end by itself after the first signal."""
POLL_S = 0.1
"""How long a wait for something outside of this process may be, before the flag is looked at again."""
_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_FAREWELL = b"\nrema: interrupted; run the same command again\n"


class Interrupted(KeyboardInterrupt):
    """A signal asked this process to stop."""

    def __init__(self, number: int) -> None:
        super().__init__(f"stopped by {signal.Signals(number).name}")
        self.exit_code = 128 + number


class _Listener:
    """Handlers of some signals, installed until ``close``; ``number`` is the first signal that arrived."""

    def __init__(self, signals: Sequence[int], grace_s: float | None) -> None:
        self.number: int | None = None
        self._done = threading.Event()
        kinds = [kind for kind in signals if signal.getsignal(kind) not in (signal.SIG_IGN, None)]  # nohup stays nohup
        self._before: dict[int, Any] = {kind: signal.signal(kind, self._handle) for kind in kinds}
        self._wakeup: int | None = None
        if grace_s is not None and os.name == "posix":
            self._watch(grace_s)

    def _watch(self, grace_s: float) -> None:
        """Have a thread told of signals too: Python calls no handler while the main thread is in foreign code."""
        reader, self._wakeup = os.pipe()
        os.set_blocking(self._wakeup, False)
        self._wakeup_before = signal.set_wakeup_fd(self._wakeup, warn_on_full_buffer=False)

        def watch() -> None:
            while data := os.read(reader, 64):
                for number in data:
                    if number in self._before:
                        self._request(number)
                        self._end_late(grace_s)
            os.close(reader)

        threading.Thread(target=watch, name="rema signals", daemon=True).start()

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self._request(number)  # nothing else: it runs between any two instructions of the main thread

    def _request(self, number: int) -> None:
        if self.number is None:
            self.number = number

    def _end_late(self, grace_s: float) -> None:
        if self._done.wait(grace_s) or self.number is None:
            return
        with suppress(OSError):
            os.write(2, _FAREWELL)
        os._exit(128 + self.number)

    def close(self) -> None:
        self._done.set()
        for kind, handler in self._before.items():
            signal.signal(kind, handler)
        if self._wakeup is not None:
            signal.set_wakeup_fd(self._wakeup_before)
            os.close(self._wakeup)

    def ignore(self) -> None:
        """From now on the signals mean nothing."""
        for kind in self._before:
            signal.signal(kind, signal.SIG_IGN)

    def forget(self) -> None:
        """In a forked child: stopping is its parent's business, and the pipe is its parent's."""
        self.number = None
        for kind in self._before:
            signal.signal(kind, signal.SIG_IGN if kind == signal.SIGINT else signal.SIG_DFL)
        if self._wakeup is not None:
            signal.set_wakeup_fd(-1)


_listener: _Listener | None = None


def requested() -> bool:
    """Whether a signal asked this process to stop."""
    return _listener is not None and _listener.number is not None


def check() -> None:
    """Raise Interrupted where a signal asked this process to stop. Called by the main thread, between two steps."""
    if _listener is not None and _listener.number is not None:
        raise Interrupted(_listener.number)


def listen() -> None:
    """Listen from now on until the process ends; nothing happens where it listens already."""
    global _listener
    if _listener is None and threading.current_thread() is threading.main_thread():
        _listener = _Listener(_SIGNALS, GRACE_S)
        atexit.register(_listener.ignore)  # called last: nothing is left to stop, and Python takes its handlers away


def leave(code: int) -> NoReturn:
    """End this process after its work was stopped: unloading large libraries can take longer than ``GRACE_S``."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):
            stream.flush()
    atexit._run_exitfuncs()  # such as the removal of temporary folders
    os._exit(code)


@contextmanager
def listening() -> Iterator[None]:
    """Listen inside the block, unless the process listens already."""
    with _installed(lambda: _Listener(_SIGNALS, GRACE_S)):
        yield


@contextmanager
def held() -> Iterator[None]:
    """Inside the block SIGINT raises KeyboardInterrupt at the next ``check``, or at the end, and nowhere else.

    For library functions that hand callbacks to foreign code. Nothing changes where the process listens already, or has
    a handler of its own.
    """
    if _listener is not None or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    with _installed(lambda: _Listener((signal.SIGINT,), None)):
        yield
        check()


@contextmanager
def _installed(make: Callable[[], _Listener]) -> Iterator[None]:
    global _listener
    if _listener is not None or threading.current_thread() is not threading.main_thread():
        yield
        return
    _listener = own = make()
    try:
        yield
    finally:
        _listener = None
        own.close()


def _after_fork() -> None:
    global _listener
    if _listener is not None:
        _listener.forget()
        _listener = None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
