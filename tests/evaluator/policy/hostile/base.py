"""What hostile policies share."""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

__all__ = ["Hostile", "Tries", "answer", "syscall", "wide"]

Tries = Iterable[Callable[[], object]]
_MACHINE = os.uname().machine
_NUMBERS = {
    "x86_64": {
        "clone": 56, "fork": 57, "vfork": 58, "clone3": 435, "add_key": 248, "request_key": 249, "keyctl": 250,
        "ioprio_set": 251, "perf_event_open": 298, "bpf": 321, "userfaultfd": 323, "kcmp": 312, "pidfd_getfd": 438,
        "fchmodat2": 452, "mincore": 27, "cachestat": 451, "sched_setattr": 314, "set_mempolicy": 238, "mbind": 237,
        "open_tree": 428, "fsopen": 430, "mount_setattr": 442, "init_module": 175, "finit_module": 313,
        "delete_module": 176, "pivot_root": 155, "io_uring_setup": 425, "memfd_secret": 447, "tkill": 200,
        "landlock_restrict_self": 446, "seccomp": 317, "process_madvise": 440, "open_by_handle_at": 304,
        "name_to_handle_at": 303, "swapon": 167, "quotactl": 179, "move_pages": 279, "sendmsg": 46, "recvfrom": 45,
        "connect": 42, "vmsplice": 278, "syslog": 103, "setxattrat": 463,
    },
    "aarch64": {
        "clone": 220, "clone3": 435, "add_key": 217, "request_key": 218, "keyctl": 219, "ioprio_set": 30,
        "perf_event_open": 241, "bpf": 280, "userfaultfd": 282, "kcmp": 272, "pidfd_getfd": 438, "fchmodat2": 452,
        "mincore": 232, "cachestat": 451, "sched_setattr": 274, "set_mempolicy": 237, "mbind": 235, "open_tree": 428,
        "fsopen": 430, "mount_setattr": 442, "init_module": 105, "finit_module": 273, "delete_module": 106,
        "pivot_root": 41, "io_uring_setup": 425, "memfd_secret": 447, "tkill": 130, "landlock_restrict_self": 446,
        "seccomp": 277, "process_madvise": 440, "open_by_handle_at": 265, "name_to_handle_at": 264, "swapon": 224,
        "quotactl": 60, "move_pages": 239, "sendmsg": 211, "recvfrom": 207, "connect": 203, "vmsplice": 75,
        "syslog": 116, "setxattrat": 463,
    },
}  # fmt: skip
_REFUSED = (1, 13, 30, 38)  # EPERM, EACCES, EROFS, and ENOSYS: the kernel has no such call


def answer(count: int, angle: int = 0) -> np.ndarray:
    """The same valid action for every observation, with an angle that carries a number."""
    return np.tile([30, 31, min(angle, 15)], (count, 1))


def syscall(name: str, *arguments: object) -> int:
    """A system call by its number; any error but a refusal counts as a call that went through."""
    number = _NUMBERS.get(_MACHINE, {}).get(name)
    if number is None:
        raise OSError(38, name)
    library = ctypes.CDLL(None, use_errno=True)
    found = int(library.syscall(number, *arguments))
    if found == -1 and ctypes.get_errno() in _REFUSED:
        raise OSError(ctypes.get_errno(), name)
    return found


def wide(value: int) -> ctypes.c_long:
    """An argument of the width of a register."""
    return ctypes.c_long(value)


class Hostile:
    """Tries everything in ``tries`` whenever it is asked."""

    harmless: ClassVar[int] = 0
    """How many of the tries may succeed, because they are of no use."""
    ends: ClassVar[str] = "denied"
    """How it is contained: its tries are ``denied``, it is a counted ``fault``, or its answers ``differ``."""

    def __init__(self, checkpoint: Path | None, device: str) -> None:
        self.checkpoint = checkpoint
        self.libc = ctypes.CDLL(None, use_errno=True)

    def act(self, observations: Any) -> np.ndarray:
        return answer(len(observations), len(self.successes()))

    def successes(self) -> list[int]:
        """Numbers of the tries that are not denied."""
        done = []
        for number, one in enumerate(self.tries()):
            with contextlib.suppress(OSError, ValueError):
                one()
                done.append(number)
        if done:
            print(type(self).__name__, done, flush=True)
        return done

    def tries(self) -> Tries:
        raise NotImplementedError

    def call(self, name: str, *arguments: object) -> int:
        """A function of the C library; any error but a refusal counts as a call that went through."""
        found = int(getattr(self.libc, name)(*arguments))
        if found == -1 and ctypes.get_errno() in _REFUSED:
            raise OSError(ctypes.get_errno(), name)
        return found
