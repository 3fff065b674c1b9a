"""Policies that weaken what supervises them, or gain more than they were given."""

from __future__ import annotations

import ctypes
import os
import resource
import threading
import time
from pathlib import Path

from tests.evaluator.policy.hostile.base import Hostile, Tries, syscall, wide

_SIGKILL = 9


class LiftsLimits(Hostile):
    """Gives itself more than it may have."""

    def tries(self) -> Tries:
        unlimited = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
        for kind in (resource.RLIMIT_DATA, resource.RLIMIT_FSIZE, resource.RLIMIT_NOFILE, resource.RLIMIT_NPROC):
            yield lambda kind=kind: resource.setrlimit(kind, unlimited)
            yield lambda kind=kind: resource.prlimit(0, kind, unlimited)
        yield lambda: Path("/proc/self/oom_score_adj").write_text("-1000")


class LeavesNamespaces(Hostile):
    """Makes namespaces and mounts, in which other rules hold."""

    def tries(self) -> Tries:
        for flags in (0x10000000, 0x20000, 0x40000000, 0x200, 0x400):
            yield lambda flags=flags: self.call("unshare", flags)
        yield lambda: self.call("setns", -1, 0)
        yield lambda: self.call("chroot", b"/absent/rema")
        yield lambda: self.call("mount", None, b"/absent/rema", None, wide(0), None)
        yield lambda: self.call("umount2", b"/absent/rema", 0)
        yield lambda: syscall("pivot_root", None, None)
        yield lambda: syscall("fsopen", None, 0)
        yield lambda: syscall("mount_setattr", -1, None, 0, None, wide(0))


class EscapesSupervision(Hostile):
    """Changes what its process says of itself to its parent and to the kernel."""

    def tries(self) -> Tries:
        for option, value in (
            (1, _SIGKILL),
            (1, 0),
            (4, 1),
            (4, 0),
            (36, 1),
            (8, 0),
            (0x59616D61, 0),
            (22, 0),
            (29, 1),
        ):
            yield lambda option=option, value=value: self.call("prctl", option, wide(value), wide(0), wide(0), wide(0))
        yield lambda: os.setsid()
        yield lambda: os.setpgid(0, 0)


class SetsClock(Hostile):
    """Sets the clock of the machine."""

    def tries(self) -> Tries:
        question = ctypes.create_string_buffer(1024)  # modes 0: it only asks
        yield lambda: self.call("adjtimex", question)
        yield lambda: self.call("clock_adjtime", time.CLOCK_REALTIME, question)
        yield lambda: self.call("clock_settime", time.CLOCK_MONOTONIC, question)  # it cannot be set
        yield lambda: self.call("settimeofday", None, question)


class RaisesPriority(Hostile):
    """Its own priority and scheduling, set to what they are."""

    def tries(self) -> Tries:
        yield lambda: os.setpriority(os.PRIO_PROCESS, 0, 0)
        yield lambda: os.setpriority(os.PRIO_USER, os.getuid(), 0)
        yield lambda: os.nice(0)
        yield lambda: os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        yield lambda: self.call("sched_setparam", 0, ctypes.byref(ctypes.c_int(0)))
        yield lambda: syscall("sched_setattr", 0, None, 0)
        yield lambda: syscall("ioprio_set", 1, 0, 0)


class PinsItself(Hostile):
    """Its own processors, set to what they are."""

    def tries(self) -> Tries:
        own = os.sched_getaffinity(0)
        for thread in (0, os.getpid(), threading.get_native_id()):
            yield lambda thread=thread: os.sched_setaffinity(thread, own)


class SlowsEvaluator(Hostile):
    """Priority, scheduling and processors of the process that started it, set to what they are."""

    def tries(self) -> Tries:
        evaluator = os.getppid()
        yield lambda: os.setpriority(os.PRIO_PROCESS, evaluator, 0)
        yield lambda: os.sched_setaffinity(evaluator, os.sched_getaffinity(0))
        yield lambda: os.sched_setscheduler(evaluator, os.SCHED_OTHER, os.sched_param(0))
        yield lambda: syscall("ioprio_set", 1, evaluator, 0)
        yield lambda: os.close(os.open(f"/proc/{evaluator}/oom_score_adj", os.O_WRONLY))
        yield lambda: os.getsid(evaluator)


class BecomesAnother(Hostile):
    """Takes the user and the rights of another."""

    def tries(self) -> Tries:
        own = os.getuid()
        for name in ("setuid", "setgid", "setreuid", "setregid", "setresuid", "setresgid", "setfsuid"):
            yield lambda name=name: self._became(name, 0)
            yield lambda name=name: self._became(name, own)
        yield lambda: os.setgroups(os.getgroups())
        yield lambda: self.call("capset", None, None)

    def _became(self, name: str, user: int) -> None:
        found = self.call(name, user, user, user)
        if name == "setfsuid":  # it never fails: it answers who it was
            raise OSError(name)
        if found != 0:
            raise OSError(name)


class LoadsIntoKernel(Hostile):
    """Loads modules and programs into the kernel; every call has arguments that are refused."""

    def tries(self) -> Tries:
        yield lambda: syscall("init_module", None, wide(0), None)
        yield lambda: syscall("finit_module", -1, None, 0)
        yield lambda: syscall("delete_module", b"rema_absent", 0)
        yield lambda: syscall("bpf", 0, None, 0)
        yield lambda: self.call("iopl", 0)
        yield lambda: self.call("personality", 0xFFFFFFFF)


class ReplacesRestrictions(Hostile):
    """Loads restrictions of its own."""

    def tries(self) -> Tries:
        yield lambda: syscall("seccomp", 1, 0, None)
        yield lambda: syscall("landlock_restrict_self", -1, 0)
        yield lambda: self.call("prctl", 38, wide(0), wide(0), wide(0), wide(0))
