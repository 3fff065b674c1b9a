"""The restrictions of a policy, set inside its own process before anything of the policy is read.

Run as a script, ``python kernel.py``, with questions on standard input and replies on standard output. The first
question says what the policy may reach; the first reply says what is restricted, each tried after it was set. The
kernel binds its rules to a thread and to those that it starts: nothing that starts threads (numpy) may come before.
"""

from __future__ import annotations

import ctypes
import errno
import importlib
import json
import os
import resource
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

__all__ = ["main"]

_PR_SET_PDEATHSIG = 1
_PR_SET_CHILD_SUBREAPER = 36
_CLONE_THREAD = 0x10000
_TRUNCATION = 3  # the first version of Landlock that covers it
_NAMESPACES = ("mnt", "net", "pid", "ipc", "user", "uts")
_LIMITED = {"RLIMIT_DATA": "memory", "RLIMIT_FSIZE": "disk", "RLIMIT_NOFILE": "descriptors"}

_DENIED = {
    "network": ("socket",),
    "processes": ("fork", "vfork", "execve", "execveat"),
    "signals": ("tkill", "pidfd_send_signal"),
    "inspection": ("ptrace", "process_vm_readv", "process_vm_writev", "pidfd_getfd", "kcmp", "process_madvise"),
    "metadata": (
        "chmod", "fchmod", "fchmodat", "fchmodat2", "chown", "fchown", "lchown", "fchownat", "setxattr", "lsetxattr",
        "fsetxattr", "setxattrat", "removexattr", "lremovexattr", "fremovexattr", "removexattrat",
    ),
    "leftovers": ("shmget", "msgget", "semget", "mq_open", "inotify_add_watch", "fanotify_init"),
    "kernel": (
        "io_uring_setup", "io_uring_enter", "io_uring_register", "bpf", "perf_event_open", "userfaultfd", "keyctl",
        "add_key", "request_key", "setns", "unshare", "mount", "umount2", "pivot_root", "chroot", "open_tree",
        "move_mount", "fsopen", "fsconfig", "fsmount", "fspick", "mount_setattr", "open_by_handle_at", "init_module",
        "finit_module", "delete_module", "kexec_load", "kexec_file_load", "reboot", "swapon", "swapoff", "acct",
        "quotactl", "settimeofday", "clock_settime", "sethostname", "setdomainname", "syslog", "iopl", "ioperm",
        "setrlimit",
    ),
}  # fmt: skip
"""System calls that fail with EPERM, with any arguments."""
_OWN_PROCESS_ONLY = ("kill", "tgkill", "rt_sigqueueinfo", "rt_tgsigqueueinfo")
_NUMBERS = {"fchmodat2": 452, "setxattrat": 463, "removexattrat": 466}
"""Of calls that an older libseccomp does not know by name; they are the same on every architecture."""


def main() -> None:
    """Restrict this process, then serve (``evaluator.policy.child``).

    The first question holds ``confine`` (bool), ``allowed`` (see ``evaluator.policy.sandbox.allowlist``) and ``limits``
    (name of a limit of ``resource`` -> value).
    """
    _die_with_parent()
    with suppress(OSError):  # where memory runs out, it is this process that has to go
        Path("/proc/self/oom_score_adj").write_text("1000")
    requests, replies = _take_standard_streams()
    orders = _read_header(requests)
    namespaces = {}
    for kind in _NAMESPACES:
        with suppress(OSError):
            namespaces[kind] = os.readlink(f"/proc/self/ns/{kind}")
    restrictions = _limit(orders["limits"])
    if orders["confine"]:
        landlock, filtered = _try(_restrict_files, orders["allowed"]), _try(_filter_calls)
        restrictions += _tried(landlock, filtered)
    else:
        restrictions += [(name, False, "not asked for") for name in _PROBES]
    sys.argv = [""]

    from evaluator.policy.child import serve

    serve(requests, replies, {"restrictions": restrictions, "namespaces": namespaces})


def _die_with_parent() -> None:
    """Let the kernel end this process together with the evaluator, also while the policy holds the interpreter.

    Where the policy may start processes, those that lose their parent stay its descendants, by which they are found.
    """
    if sys.platform == "linux":
        library = ctypes.CDLL(None)
        library.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        library.prctl(_PR_SET_CHILD_SUBREAPER, 1)


def _take_standard_streams() -> tuple[int, int]:
    """The pipes of questions and replies, under other numbers; what the policy prints goes to the log."""
    requests, replies = os.dup(0), os.dup(1)
    empty = os.open(os.devnull, os.O_RDONLY)
    os.dup2(empty, 0)
    os.close(empty)
    os.dup2(2, 1)
    return requests, replies


def _read_header(requests: int) -> dict[str, Any]:
    """The header of a frame without arrays (``evaluator.policy.wire`` needs numpy)."""

    def read(count: int) -> bytes:
        data = b""
        while len(data) < count:
            data += os.read(requests, count - len(data)) or sys.exit("the evaluator has ended")
        return data

    header: dict[str, Any] = json.loads(read(int.from_bytes(read(4), "big")))
    return header


def _limit(limits: dict[str, int]) -> list[tuple[str, bool, str]]:
    """Set the limits of the process; which of memory, disk and descriptors are limited."""
    found = []
    for name, value in limits.items():
        detail = f"{name} {value}"
        try:
            kind = getattr(resource, name)
            _, hard = resource.getrlimit(kind)
            value = value if hard == resource.RLIM_INFINITY else min(value, hard)
            resource.setrlimit(kind, (value, value))
            up = resource.getrlimit(kind) == (value, value)
        except (AttributeError, ValueError, OSError) as error:
            up, detail = False, f"{detail}: {error}"
        if name in _LIMITED:
            found.append((_LIMITED[name], up, detail))
    return found


def _try(restrict: Callable[..., str], *arguments: Any) -> tuple[bool, str]:
    """Whether a library could set its restrictions, and by what or why not."""
    try:
        return True, restrict(*arguments)
    except ImportError as error:
        return False, f"{error.name or error} is not installed"
    except Exception as error:  # reported as not restricted; the policy still runs
        return False, f"{type(error).__name__}: {error}"


def _restrict_files(allowed: dict[str, list[str]]) -> str:
    """Landlock: files by an allow-list, no TCP, no signals and no abstract sockets to processes outside."""
    landlock = importlib.import_module("landlockpy")
    version = landlock.abi_version()
    if version < _TRUNCATION:
        found = f"version {version} of Landlock, which does not cover truncation" if version else "no Landlock"
        raise RuntimeError(f"the kernel has {found}")
    right = landlock.AccessFS
    code = right.READ_FILE | right.EXECUTE
    device = right.READ_FILE | right.WRITE_FILE | right.TRUNCATE | right.IOCTL_DEV
    whole = (
        right.READ_FILE | right.READ_DIR | right.WRITE_FILE | right.TRUNCATE | right.REFER | right.MAKE_REG
        | right.MAKE_DIR | right.MAKE_SYM | right.MAKE_FIFO | right.REMOVE_FILE | right.REMOVE_DIR
    )  # fmt: skip
    with landlock.Ruleset(scoped=landlock.Scope.SIGNAL | landlock.Scope.ABSTRACT_UNIX_SOCKET) as rules:
        for kind, access in (("read", code), ("listed", right.NONE), ("devices", device), ("write", whole)):
            for path in allowed[kind]:
                with suppress(FileNotFoundError):
                    rules.allow_path(path, access | right.READ_DIR if os.path.isdir(path) else access)
        rules.restrict()
    return f"Landlock {version}"


def _filter_calls() -> str:
    """seccomp: no sockets, no new processes, no signals to others, no looking into others, little of the kernel."""
    try:
        seccomp = importlib.import_module("pyseccomp")
    except RuntimeError as error:  # the binding is there, and the library is not
        raise ImportError(str(error), name="libseccomp") from error
    calls = seccomp.SyscallFilter(seccomp.ALLOW)
    denied = seccomp.ERRNO(errno.EPERM)

    def number(name: str) -> int | None:
        found = int(seccomp.resolve_syscall(seccomp.Arch.NATIVE, name))
        return found if found >= 0 else _NUMBERS.get(name)

    def deny(name: str, *conditions: Any, action: int = denied) -> None:
        if (call := number(name)) is not None:
            calls.add_rule(action, call, *conditions)

    for names in _DENIED.values():
        for name in names:
            deny(name)
    for name in _OWN_PROCESS_ONLY:
        deny(name, seccomp.Arg(0, seccomp.NE, os.getpid()))
    deny("clone", seccomp.Arg(0, seccomp.MASKED_EQ, _CLONE_THREAD, 0))
    deny("clone3", action=seccomp.ERRNO(errno.ENOSYS))  # its flags are in memory; the C library then calls clone
    deny("prlimit64", seccomp.Arg(2, seccomp.NE, 0))
    calls.load()
    return "seccomp"


def _tried(landlock: tuple[bool, str], filtered: tuple[bool, str]) -> list[tuple[str, bool, str]]:
    """Try everything that should be denied: by what it is denied, or why it is not."""
    found = []
    for name, (builders, probe) in _PROBES.items():
        by_library = {"landlock": landlock, "seccomp": filtered}
        by = " and ".join(by_library[builder][1] for builder in builders if by_library[builder][0])
        why = "; ".join(by_library[builder][1] for builder in builders if not by_library[builder][0])
        try:
            up = probe() is _UNSEEN
        except PermissionError:
            up = True
        found.append((name, up, (by or "denied already") if up else why or "it was tried and not denied"))
    return found


def _open_socket() -> object:
    import _socket

    _socket.socket(_socket.AF_INET, _socket.SOCK_DGRAM).close()
    return None


def _fork() -> object:
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)
    return None


def _signal_parent() -> object:
    parent = os.getppid()
    if not parent:
        return _UNSEEN
    os.kill(parent, 0)
    return None


def _inspect_parent() -> object:
    parent = os.getppid()
    return os.stat(f"/proc/{parent}/fd/0") if parent else _UNSEEN


_UNSEEN = object()
"""There is no other process in sight."""
_PROBES: dict[str, tuple[tuple[str, ...], Callable[[], object]]] = {
    "files": (("landlock",), lambda: os.listdir("/")),
    "network": (("seccomp",), _open_socket),
    "processes": (("seccomp",), _fork),
    "signals": (("landlock", "seccomp"), _signal_parent),
    "inspection": (("landlock", "seccomp"), _inspect_parent),
}
"""What sets each restriction, and a call that must fail under it."""


if __name__ == "__main__":
    main()
