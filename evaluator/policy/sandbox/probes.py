"""What must be denied, tried once the restrictions are set: a restriction counts if every try of it fails.

Every try is harmless where it goes through: it asks, it sets what is set already, or its arguments are refused.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import resource
import signal
import socket
import time
from collections.abc import Callable, Iterable

__all__ = ["PROBES", "Standing", "tried"]

_FS_IOC_SETFLAGS = 0x40086602
_PR_SET_PDEATHSIG = 1
_IOPRIO_SET = {"x86_64": 251, "aarch64": 30}
_IOPRIO_WHO_PROCESS = 1
_ABSENT_KEY = 0x52454D41


class Standing:
    """What is set before the restrictions are: a try sets it to the same value."""

    def __init__(self) -> None:
        self.priority = os.getpriority(os.PRIO_PROCESS, 0)
        self.processors = os.sched_getaffinity(0)
        self.scheduler = os.sched_getscheduler(0)
        self.scheduler_priority = os.sched_getparam(0)
        self.core = (ctypes.c_ulong * 2)(*(value % (1 << 64) for value in resource.getrlimit(resource.RLIMIT_CORE)))
        self.library = ctypes.CDLL(None, use_errno=True)

    def call(self, name: str, *arguments: object) -> None:
        """A function of the C library; raises OSError where it answers -1."""
        if getattr(self.library, name)(*arguments) == -1:
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))


Tries = Iterable[Callable[[], object]]


def _files(_: Standing) -> Tries:
    yield lambda: os.listdir("/")


def _network(_: Standing) -> Tries:
    yield lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM).close()
    yield lambda: socket.socket(socket.AF_UNIX, socket.SOCK_STREAM).close()


def _processes(_: Standing) -> Tries:
    def fork() -> None:
        child = os.fork()
        if child == 0:
            os._exit(0)
        os.waitpid(child, 0)

    yield fork
    yield lambda: os.execv("", ["absent"])


def _signals(_: Standing) -> Tries:
    parent = os.getppid()
    if parent:  # 0: it is in a namespace of its own
        yield lambda: os.kill(parent, 0)


def _inspection(standing: Standing) -> Tries:
    parent = os.getppid()
    if parent:
        yield lambda: os.stat(f"/proc/{parent}/fd/0")
    yield lambda: standing.call("process_vm_readv", os.getpid(), None, 0, None, 0, 0)


def _clock(standing: Standing) -> Tries:
    question = ctypes.create_string_buffer(1024)  # a timex whose modes are 0 changes nothing
    yield lambda: standing.call("adjtimex", question)
    yield lambda: standing.call("clock_adjtime", time.CLOCK_REALTIME, question)
    yield lambda: standing.call("clock_settime", time.CLOCK_MONOTONIC, question)  # a clock that nobody can set


def _scheduling(standing: Standing) -> Tries:
    yield lambda: os.setpriority(os.PRIO_PROCESS, 0, standing.priority)
    yield lambda: os.sched_setaffinity(0, standing.processors)
    yield lambda: os.sched_setscheduler(0, standing.scheduler, standing.scheduler_priority)
    number = _IOPRIO_SET.get(os.uname().machine)
    if number is not None:
        yield lambda: standing.call("syscall", number, _IOPRIO_WHO_PROCESS, 0, 0)


def _attributes(_: Standing) -> Tries:
    here = os.open(".", os.O_RDONLY | os.O_CLOEXEC)
    about = os.fstat(here)
    yield lambda: os.utime(here, ns=(about.st_atime_ns, about.st_mtime_ns))
    yield lambda: os.fchmod(here, about.st_mode & 0o7777)
    yield lambda: os.fchown(here, -1, -1)
    yield lambda: fcntl.ioctl(here, _FS_IOC_SETFLAGS, 0)  # an address that cannot be read
    yield lambda: fcntl.flock(here, fcntl.LOCK_UN)
    os.close(here)


def _queues(standing: Standing) -> Tries:
    yield lambda: standing.call("shmget", 0, 0, 0)  # a size that is refused
    yield lambda: standing.call("msgget", _ABSENT_KEY, 0)
    yield lambda: standing.call("semget", 0, -1, 0)
    yield lambda: standing.call("memfd_create", None, 0)


def _supervision(standing: Standing) -> Tries:
    yield lambda: standing.call("prctl", _PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    yield lambda: standing.call("setrlimit", resource.RLIMIT_CORE, standing.core)


PROBES: dict[str, tuple[tuple[str, ...], Callable[[Standing], Tries]]] = {
    "files": (("landlock",), _files),
    "network": (("seccomp",), _network),
    "processes": (("seccomp",), _processes),
    "signals": (("landlock", "seccomp"), _signals),
    "inspection": (("landlock", "seccomp"), _inspection),
    "clock": (("seccomp",), _clock),
    "scheduling": (("seccomp",), _scheduling),
    "attributes": (("seccomp",), _attributes),
    "queues": (("seccomp",), _queues),
    "supervision": (("seccomp",), _supervision),
}
"""What sets each restriction, and calls that must fail under it."""


def tried(standing: Standing, set_by: dict[str, tuple[bool, str]]) -> list[tuple[str, bool, str]]:
    """Try everything that should be denied: by what it is denied, or why it is not.

    ``set_by`` says of every library whether it could set its restrictions, and by what or why not.
    """
    found = []
    for name, (builders, tries) in PROBES.items():
        by = " and ".join(set_by[builder][1] for builder in builders if set_by[builder][0])
        why = "; ".join(set_by[builder][1] for builder in builders if not set_by[builder][0])
        outcomes = [_denied(one) for one in tries(standing)]  # every one is tried
        up = all(outcomes)
        found.append((name, up, (by or "denied already") if up else why or "it was tried and not denied"))
    return found


def _denied(one: Callable[[], object]) -> bool:
    try:
        one()
    except OSError as error:
        return error.errno in (errno.EPERM, errno.EACCES)
    return False
