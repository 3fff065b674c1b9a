"""The restrictions of a policy, set inside its own process before anything of the policy is read.

Run as a module, with questions on standard input and replies on standard output. The first question says what the
policy may reach; the first reply says what is restricted, each tried after it was set. The kernel binds its rules to a
thread and to those that it starts: nothing that starts threads (numpy) may come before.
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from evaluator.policy.sandbox.calls import filter_calls
from evaluator.policy.sandbox.privileges import (
    barrier,
    drop_privileges,
    in_user_namespace,
    keep_supervised,
    mount_temporary,
)
from evaluator.policy.sandbox.probes import PROBES, Standing, tried

__all__ = ["main"]

_TRUNCATION = 3  # the first version of Landlock that covers it
_NAMESPACES = ("mnt", "net", "pid", "ipc", "user", "uts")
_LIMITED = {"RLIMIT_DATA": "memory", "RLIMIT_FSIZE": "disk", "RLIMIT_NOFILE": "descriptors"}
_STREAMS = 3
_PLAIN_DEVICES = ("null", "zero", "full", "random", "urandom")


def main() -> None:
    """Restrict this process, then serve (``evaluator.policy.child``).

    The first question holds ``confine`` (bool), ``allowed`` (see ``evaluator.policy.sandbox.allowlist``), ``limits``
    (name of a limit of ``resource`` -> value), ``user`` (to become, if this is root) and its ``groups``, the folders of
    modules that it ``imports``, and for the ``temporary`` folder its path and most ``bytes`` and ``files``.
    """
    keep_supervised()
    with suppress(OSError):  # where memory runs out, it is this process that has to go
        Path("/proc/self/oom_score_adj").write_text("1000")
    requests, replies = _take_standard_streams()
    orders = _read_header(requests)
    namespaces = {}
    for kind in _NAMESPACES:
        with suppress(OSError):
            namespaces[kind] = os.readlink(f"/proc/self/ns/{kind}")
    if orders["confine"] and sys.platform == "linux":
        restrictions = _confine(orders)
    else:
        why = f"{sys.platform} has neither Landlock nor seccomp" if orders["confine"] else "not asked for"
        restrictions = _limit(orders["limits"]) + [(name, False, why) for name in ("privileges", *PROBES)]
    sys.argv = [""]

    from evaluator.policy.child import serve

    serve(requests, replies, {"restrictions": restrictions, "namespaces": namespaces})


def _confine(orders: dict[str, Any]) -> list[tuple[str, bool, str]]:
    """Set every restriction that this machine has; name, whether it is set, and by what or why not."""
    allowed, temporary = orders["allowed"], orders["temporary"]
    needed = [*allowed["read"], *allowed["listed"], *allowed["devices"]]
    user = None if in_user_namespace() else orders["user"]
    mounted = _try(mount_temporary, temporary["path"], temporary["bytes"], temporary["files"], user, needed)
    kept = ""
    if user is not None:
        if not mounted[0]:
            os.chown(temporary["path"], user, user)
        closed = [path for path in orders["imports"] if _closed(path, mounted[0])]
        if closed:
            os.chown(temporary["path"], 0, 0)
            user, kept = None, f"it stays root: another user cannot read {closed[0]}"
    disk = mounted[1] if mounted[0] else f"measured from outside ({mounted[1]})"
    restrictions = [
        (name, up, f"{detail}; {disk}" if name == "disk" else detail) for name, up, detail in _limit(orders["limits"])
    ]
    standing = Standing()
    dropped, how = drop_privileges(user, orders["groups"])
    restrictions.append(("privileges", dropped, kept or how))
    keep_supervised()
    accelerators = any(os.path.basename(path) not in _PLAIN_DEVICES for path in allowed["devices"])
    landlock, filtered = _try(_restrict_files, allowed), _try(filter_calls, accelerators)
    return restrictions + tried(standing, {"landlock": landlock, "seccomp": filtered})


def _closed(path: str, mounted: bool) -> bool:
    """Whether another user cannot read a folder of modules; what is around it was opened where it was ``mounted``."""
    everybody = stat.S_IROTH | stat.S_IXOTH
    if not os.path.isdir(path):
        return False
    return os.stat(path).st_mode & everybody != everybody or (not mounted and bool(barrier(path)))


def _take_standard_streams() -> tuple[int, int]:
    """The pipes of questions and replies, under other numbers; what the policy prints goes to the log."""
    requests, replies = os.dup(0), os.dup(1)
    empty = os.open(os.devnull, os.O_RDONLY)
    os.dup2(empty, 0)
    os.close(empty)
    os.dup2(2, 1)
    low, high = sorted((requests, replies))
    os.closerange(_STREAMS, low)  # nothing else that was open passes to the policy
    os.closerange(low + 1, high)
    os.closerange(high + 1, os.sysconf("SC_OPEN_MAX"))
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


if __name__ == "__main__":
    main()
