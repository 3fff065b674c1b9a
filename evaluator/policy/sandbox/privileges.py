"""The user, the capabilities and the mounts of a policy's process, given up before anything of the policy is read.

Where the kernel lets it (as root, or with a user namespace of its own), the process mounts a file system of limited
size over its temporary folder, in a mount namespace of its own.
"""

from __future__ import annotations

import ctypes
import os
import stat
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

__all__ = ["barrier", "drop_privileges", "in_user_namespace", "keep_supervised", "mount_temporary"]

_PR_SET_PDEATHSIG, _PR_SET_DUMPABLE, _PR_CAPBSET_DROP, _PR_SET_CHILD_SUBREAPER = 1, 4, 24, 36
_PR_SET_NO_NEW_PRIVS, _PR_CAP_AMBIENT, _PR_CAP_AMBIENT_CLEAR_ALL = 38, 47, 4
_CLONE_NEWNS, _CLONE_NEWUSER = 0x20000, 0x10000000
_MS_NOSUID, _MS_NODEV, _MS_BIND, _MS_REC, _MS_PRIVATE = 0x2, 0x4, 0x1000, 0x4000, 0x40000
_MOUNT_SETATTR = 442
_AT_FDCWD, _AT_RECURSIVE = -100, 0x8000
_RDONLY = 0x1
_CAPABILITIES = ("CapInh", "CapPrm", "CapEff", "CapAmb")
_LARGEST_CAPABILITY = 63
_WHOLE_MAP = ["0", "0", str((1 << 32) - 1)]
_CAPABILITY_VERSION = 0x20080522
_SIGKILL = 9


def _library() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _check(result: int, what: str) -> None:
    if result != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"{what}: {os.strerror(number)}")


def mount_temporary(folder: str, size: int, files: int, user: int | None, needed: Iterable[str]) -> str:
    """Mount a file system of ``size`` bytes and ``files`` files over ``folder``, for this process alone; what did it.

    ``user`` will own it; None: the present one does. Where another user will go on, folders that only root may enter
    are replaced by others that show only what is ``needed`` of them. Raises OSError where the kernel does not let it.
    """
    library = _library()
    own, group = os.geteuid(), os.getegid()
    if user is not None:  # in a user namespace there would be no other user to become
        _check(library.unshare(_CLONE_NEWNS), "unshare")
    elif own != 0 or library.unshare(_CLONE_NEWNS) != 0:
        _check(library.unshare(_CLONE_NEWUSER | _CLONE_NEWNS), "unshare")
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"{own} {own} 1")
        Path("/proc/self/gid_map").write_text(f"{group} {group} 1")
    _check(library.mount(None, b"/", None, _MS_REC | _MS_PRIVATE, None), "mount /")
    if user is not None:
        own, group = user, user
        _open_ways(library, sorted(needed))
    # Last: the folder may lie in one of those that were replaced.
    os.makedirs(folder, exist_ok=True)
    _mount_tmpfs(library, folder, f"size={size},nr_inodes={files},mode=700,uid={own},gid={group}")
    with suppress(OSError):  # before Linux 5.12
        _make_read_only(library, "/", _AT_RECURSIVE, True)
        _make_read_only(library, folder, 0, False)
    os.chdir(folder)
    return f"tmpfs of {size} bytes and {files} files"


def _mount_tmpfs(library: ctypes.CDLL, folder: str, options: str) -> None:
    _check(
        library.mount(b"tmpfs", os.fsencode(folder), b"tmpfs", _MS_NOSUID | _MS_NODEV, options.encode()),
        f"mount {folder}",
    )


def _make_read_only(library: ctypes.CDLL, place: str, flags: int, yes: bool) -> None:
    """Let nothing be written below a mount; reading a file does not even note when, for another process to see."""
    attributes = (ctypes.c_uint64 * 4)(*((_RDONLY, 0) if yes else (0, _RDONLY)))
    size = ctypes.sizeof(attributes)
    call = library.syscall(_MOUNT_SETATTR, _AT_FDCWD, os.fsencode(place), flags, ctypes.byref(attributes), size)
    _check(call, "mount_setattr")


def barrier(path: str) -> str:
    """The outermost folder around ``path`` that only its owner or group may enter; empty where there is none."""
    for parent in reversed(Path(path).parents):
        if not os.stat(parent).st_mode & stat.S_IXOTH:
            return str(parent)
    return ""


def _open_ways(library: ctypes.CDLL, paths: list[str]) -> None:
    """Let another user reach ``paths`` (sorted) through folders that are closed to it: what else is in them is gone."""
    inside: dict[str, dict[str, int]] = {}
    for path in paths:
        with suppress(FileNotFoundError):
            closed = barrier(path)
            kept = inside.setdefault(closed, {}) if closed else {}
            if closed and not any(path.startswith(f"{other}/") for other in kept):
                kept[path] = os.open(path, os.O_PATH | os.O_CLOEXEC)
    for closed, kept in inside.items():
        _mount_tmpfs(library, closed, "mode=755")
        for path, number in kept.items():
            source = f"/proc/self/fd/{number}"
            if os.path.isdir(source):
                os.makedirs(path)
            else:
                os.makedirs(os.path.dirname(path), exist_ok=True)
                Path(path).touch()
            _check(
                library.mount(os.fsencode(source), os.fsencode(path), None, _MS_BIND | _MS_REC, None), f"mount {path}"
            )
            os.close(number)


def drop_privileges(user: int | None, groups: list[int]) -> tuple[bool, str]:
    """Become ``user`` (None: stay) with ``groups``, without any capability; whether that worked, and how.

    Root in a user namespace (in a container of an ordinary user) is an ordinary user outside, and may stay.
    """
    library = _library()
    library.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    for capability in range(_LARGEST_CAPABILITY + 1):
        library.prctl(_PR_CAPBSET_DROP, capability, 0, 0, 0)
    library.prctl(_PR_CAP_AMBIENT, _PR_CAP_AMBIENT_CLEAR_ALL, 0, 0, 0)
    if user is not None:
        with suppress(OSError):
            os.setgroups(groups)
            os.setresgid(user, user, user)
            os.setresuid(user, user, user)
    header = (ctypes.c_uint32 * 2)(_CAPABILITY_VERSION, 0)
    library.capset(ctypes.byref(header), ctypes.byref((ctypes.c_uint32 * 6)()))
    if any(int(_status().get(name, "0"), 16) for name in _CAPABILITIES):
        return False, "it has capabilities"
    if os.geteuid() == 0 and not in_user_namespace():
        return False, "it is root"
    return True, "no capabilities" if os.geteuid() != user else "an unused user, no capabilities"


def keep_supervised() -> None:
    """Let the kernel end this process together with the evaluator, which may look at what it uses.

    Where the policy may start processes, those that lose their parent stay its descendants, by which they are found.
    A change of user resets both, so this comes after it.
    """
    if sys.platform == "linux":
        library = _library()
        library.prctl(_PR_SET_PDEATHSIG, _SIGKILL, 0, 0, 0)
        library.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        library.prctl(_PR_SET_DUMPABLE, 1, 0, 0, 0)


def _status() -> dict[str, str]:
    lines = Path("/proc/self/status").read_text().splitlines()
    return {name: value.strip() for name, _, value in (line.partition(":") for line in lines)}


def in_user_namespace() -> bool:
    """Whether root is not the root of the machine."""
    with suppress(OSError):
        return Path("/proc/self/uid_map").read_text().split() != _WHOLE_MAP
    return False
