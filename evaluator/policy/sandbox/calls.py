"""The system calls of a policy: an allow-list, kept by seccomp. Every other call fails with EPERM.

What is allowed is what Python, numpy, torch, ONNX Runtime and OpenVINO need to compute: files (Landlock says which),
memory, threads, and waiting. What talks to others, outlives the process or weakens its supervision is not on the list.
"""

from __future__ import annotations

import errno
import importlib
import os
from collections.abc import Iterable
from typing import Any

__all__ = ["filter_calls"]

_FILES = (
    "access", "chdir", "close", "close_range", "copy_file_range", "creat", "dup", "dup2", "dup3", "faccessat",
    "faccessat2", "fadvise64", "fallocate", "fchdir", "fdatasync", "fstat", "fstatfs", "fsync", "ftruncate", "getcwd",
    "getdents", "getdents64", "link", "linkat", "lseek", "lstat", "mkdir", "mkdirat", "newfstatat", "open", "openat",
    "openat2", "pread64", "preadv", "preadv2", "pwrite64", "pwritev", "pwritev2", "read", "readahead", "readlink",
    "readlinkat", "readv", "rename", "renameat", "renameat2", "rmdir", "sendfile", "stat", "statfs", "statx", "symlink",
    "symlinkat", "truncate", "umask", "unlink", "unlinkat", "write", "writev",
)  # fmt: skip
_MEMORY = (
    "brk", "get_mempolicy", "madvise", "membarrier", "mprotect", "mremap", "msync", "munmap", "pkey_alloc", "pkey_free",
    "pkey_mprotect",
)  # fmt: skip
_THREADS = (
    "arch_prctl", "exit", "exit_group", "futex", "futex_waitv", "get_robust_list", "getcpu", "rseq",
    "sched_get_priority_max", "sched_get_priority_min", "sched_getaffinity", "sched_yield", "set_robust_list",
    "set_tid_address",
)  # fmt: skip
_WAITING = (
    "alarm", "clock_getres", "clock_gettime", "clock_nanosleep", "epoll_create", "epoll_create1", "epoll_ctl",
    "epoll_pwait", "epoll_pwait2", "epoll_wait", "eventfd", "eventfd2", "getitimer", "gettimeofday", "nanosleep",
    "pause", "pipe", "pipe2", "poll", "ppoll", "pselect6", "restart_syscall", "rt_sigaction", "rt_sigpending",
    "rt_sigprocmask", "rt_sigreturn", "rt_sigsuspend", "rt_sigtimedwait", "select", "setitimer", "sigaltstack",
    "signalfd4", "time", "timer_create", "timer_delete", "timer_getoverrun", "timer_gettime", "timer_settime",
    "timerfd_create", "timerfd_gettime", "timerfd_settime", "times",
)  # fmt: skip
_ABOUT_ITSELF = (
    "capget", "getegid", "geteuid", "getgid", "getgroups", "getpgrp", "getpid", "getppid", "getrandom", "getresgid",
    "getresuid", "getrlimit", "getrusage", "gettid", "getuid", "sysinfo", "uname",
)  # fmt: skip
_ALLOWED = (*_FILES, *_MEMORY, *_THREADS, *_WAITING, *_ABOUT_ITSELF)
"""With any arguments."""
_TO_ITSELF = ("kill", "tgkill", "rt_sigqueueinfo", "rt_tgsigqueueinfo")
"""With the number of this process as the first argument."""
_CLONE_THREAD, _NEW_NAMESPACES = 0x10000, 0x7E020080
"""Flags of clone: a thread is allowed, a process and namespaces are not."""
_DESCRIPTOR_COMMANDS = (0, 1, 2, 3, 4, 1030, 1032)
"""Of fcntl: F_DUPFD, F_GETFD, F_SETFD, F_GETFL, F_SETFL, F_DUPFD_CLOEXEC, F_GETPIPE_SZ. No locks, leases, owners of
signals, notices about folders, or larger pipes."""
_TERMINAL_QUESTIONS = (0x5401, 0x5413, 0x541B, 0x5421, 0x5450, 0x5451)
"""Of ioctl: TCGETS, TIOCGWINSZ, FIONREAD, FIONBIO, FIONCLEX, FIOCLEX."""
_ACCELERATOR_CALLS = ("mbind", "mlock", "mlock2", "munlock", "set_mempolicy")
"""Where the own memory lies, which drivers of accelerators decide."""
_ACCELERATOR_TYPES = (0x00, 0x46, 0x48, 0x4B, 0x64)
"""Second byte of the ioctl commands of NVIDIA (0x00, F), Habana (H), ROCm (K) and DRM (d)."""
_PROCESS_QUESTIONS = (2, 3, 15, 16, 23, 30, 0x53564D41)
"""Of prctl: PR_GET_PDEATHSIG, PR_GET_DUMPABLE, PR_SET_NAME and PR_GET_NAME (of a thread), PR_CAPBSET_READ,
PR_GET_TIMERSLACK, PR_SET_VMA (the name of a piece of memory)."""
_SHARED, _ANONYMOUS = 0x01, 0x20
"""Flags of mmap. Memory with both counts towards no limit of a process."""
_MISSING = ("clone3",)
"""Calls that are denied with ENOSYS: the C library then takes another one, whose arguments can be checked."""
_NUMBERS = {
    "clone3": 435,
    "close_range": 436,
    "openat2": 437,
    "faccessat2": 439,
    "epoll_pwait2": 441,
    "futex_waitv": 449,
}
"""Of calls that an older libseccomp does not know by name; they are the same on every architecture."""


def filter_calls(accelerators: bool) -> str:
    """Deny every call of this process, and of threads that it starts, that is not on the list; what did it.

    ``accelerators``: also allow to control their devices.
    """
    try:
        seccomp = importlib.import_module("pyseccomp")
    except RuntimeError as error:  # the binding is there, and the library is not
        raise ImportError(str(error), name="libseccomp") from error
    calls = seccomp.SyscallFilter(seccomp.ERRNO(errno.EPERM))
    own = os.getpid()

    def allow(name: str, *conditions: Any, action: int = seccomp.ALLOW) -> None:
        number = int(seccomp.resolve_syscall(seccomp.Arch.NATIVE, name))
        number = number if number >= 0 else _NUMBERS.get(name, -1)
        if number >= 0:  # this architecture has it
            calls.add_rule(action, number, *conditions)

    def allow_values(name: str, argument: int, values: Iterable[int]) -> None:
        for value in values:
            allow(name, seccomp.Arg(argument, seccomp.EQ, value))

    for name in (*_ALLOWED, *(_ACCELERATOR_CALLS if accelerators else ())):
        allow(name)
    for name in _TO_ITSELF:
        allow_values(name, 0, (own,))
    for process in (0, own):  # what its limits are, not what they shall be
        allow("prlimit64", seccomp.Arg(0, seccomp.EQ, process), seccomp.Arg(2, seccomp.EQ, 0))
    allow("clone", seccomp.Arg(0, seccomp.MASKED_EQ, _CLONE_THREAD | _NEW_NAMESPACES, _CLONE_THREAD))
    for flag in (_SHARED, _ANONYMOUS):
        allow("mmap", seccomp.Arg(3, seccomp.MASKED_EQ, flag, 0))
    allow_values("fcntl", 1, _DESCRIPTOR_COMMANDS)
    allow_values("prctl", 0, _PROCESS_QUESTIONS)
    allow_values("ioctl", 1, _TERMINAL_QUESTIONS)
    for kind in _ACCELERATOR_TYPES if accelerators else ():
        allow("ioctl", seccomp.Arg(1, seccomp.MASKED_EQ, 0xFF00, kind << 8))
    for name in _MISSING:
        allow(name, action=seccomp.ERRNO(errno.ENOSYS))
    calls.load()
    return "seccomp"
