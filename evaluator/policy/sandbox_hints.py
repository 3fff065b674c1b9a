"""What the sandbox has to do with an error of a policy, in one line: which rule, which path, and what to do."""

from __future__ import annotations

import errno
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evaluator.policy.output import printable
from evaluator.policy.sandbox.limits import PolicyLimits
from evaluator.policy.sandbox.snapshot import Snapshot

__all__ = ["Cause", "Surroundings", "sandbox_hint"]

_DENIED = (errno.EPERM, errno.EACCES, errno.EROFS)
_PROCESSES = ("subprocess", "multiprocessing", "concurrent", "torch.multiprocessing", "torch.utils.data", "os.fork")
_NETWORK = ("socket", "ssl", "asyncio", "selectors", "urllib", "urllib3", "requests", "http", "httpx", "aiohttp")
_LEVELS = 4  # folders around the policy that are searched for a module


@dataclass(frozen=True, slots=True)
class Cause:
    """The error at the bottom of what a policy raised, as its process reports it."""

    kinds: tuple[str, ...] = ()  # its type and the bases, ``module.name``
    number: int = 0  # errno
    path: str = ""
    name: str = ""  # of a module that is missing, or of a variable of the environment
    module: str = ""  # in which it was raised
    text: str = ""

    @staticmethod
    def of(header: dict[str, Any]) -> Cause:
        """From the reply of a process; no value in it is trusted to have the right type."""
        found = header.get("cause")
        found = found if isinstance(found, dict) else {}
        words = {name: printable(found[name]) for name in ("path", "name", "module", "text") if name in found}
        number, kinds = found.get("number"), found.get("kinds")
        kinds = tuple(kind for kind in kinds if isinstance(kind, str)) if isinstance(kinds, list) else ()
        return Cause(kinds, number if type(number) is int else 0, **words)


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What is known outside of the sandbox."""

    policy: Path  # the user's file
    snapshot: Snapshot
    temporary: Path
    limits: PolicyLimits
    confined: bool  # whether the kernel restricts the process

    def readable(self, text: str) -> str:
        """A text of the process, with the paths that the user knows."""
        return self.snapshot.original(text).replace(str(self.temporary), "$TMPDIR")


def sandbox_hint(cause: Cause, around: Surroundings) -> str:
    """Which rule of the sandbox caused an error, and what to do; empty where none did."""
    kinds = {kind.removeprefix("builtins.") for kind in cause.kinds}
    if "KeyError" in kinds and cause.name:
        return _variable(cause.name)
    if "ImportError" in kinds:
        return _import(cause, around)
    if "MemoryError" in kinds or cause.number == errno.ENOMEM:
        return f"rule memory: a policy may use {around.limits.memory / (1 << 30):.1f} GiB: load less at a time"
    if cause.number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        size, files = around.limits.disk_bytes / (1 << 30), around.limits.disk_files
        return f"rule disk: the temporary folder may hold {size:.1f} GiB in {files:,} files: remove what is not needed"
    if cause.number == errno.EMFILE:
        return f"rule descriptors: {around.limits.open_files} files may be open at a time: close those that were read"
    if "RuntimeError" in kinds and "start new thread" in cause.text:
        return f"rule tasks: a policy may have {around.limits.tasks} threads: lower the number of its workers"
    if "FileNotFoundError" in kinds:
        return _missing(cause.path, around)
    if "gaierror" in {kind.rpartition(".")[2] for kind in kinds}:
        return _NO_NETWORK
    if around.confined and cause.number in _DENIED:
        return _denied(cause, around)
    return ""


_NO_NETWORK = (
    "rule network: no connection is allowed: download before the evaluation, and name what was downloaded with "
    "--checkpoint"
)
_NO_PROCESSES = "rule processes: no process may be started: compute in this one, or in threads (num_workers=0)"
_NO_CALLS = (
    "rule calls: the system call is denied; processes, connections, shared memory, locks, priorities, and modes and "
    "times of files are: docs/threat_model.md"
)


def _variable(name: str) -> str:
    if name not in os.environ:
        return ""
    return (
        f"rule environment: the variable {name} is not passed to a policy: write the value into a file beside the "
        "policy, and read that"
    )


def _import(cause: Cause, around: Surroundings) -> str:
    if "relative import" in cause.text:
        return (
            f"{around.policy.name} is loaded by itself, not as a module of a package: import by the full name of the "
            "package (from my_package.module import name), whose folders have an __init__.py"
        )
    first = cause.name.partition(".")[0]
    if not first.isidentifier():
        return ""
    for folder in (*list(around.policy.parents)[:_LEVELS], Path.cwd()):
        for place in (folder / first, folder / f"{first}.py"):
            if not place.exists():
                continue
            if why := _left_out(place, around):
                return f"rule files: {place} is not in the copy that the policy runs from: {why}"
            return (
                f"rule files: {place} is outside of the policy's folder, of which a copy runs: move it beside "
                f"{around.policy.name}, or install it"
            )
    return ""


def _left_out(place: Path, around: Surroundings) -> str:
    """Why a file of the user is not in the copy; empty where it is, or is outside of the policy's folder."""
    return next(
        (why for path, why in around.snapshot.left_out.items() if place == path or place.is_relative_to(path)), ""
    )


def _missing(text: str, around: Surroundings) -> str:
    if not text:
        return ""
    path = Path(text)
    if not path.is_absolute():
        beside, here = around.policy.parent / path, Path.cwd() / path
        if beside.exists():
            return f"rule folder: a policy does not run in your folder: write Path(__file__).parent / {str(path)!r}"
        if here.exists():
            return (
                f"rule folder: a policy does not run in your folder: name {here} with --checkpoint, or copy it beside "
                f"{around.policy.name} and write Path(__file__).parent / {path.name!r}"
            )
        return ""
    if path.is_relative_to(around.temporary):
        home = Path(os.path.expanduser("~")) / path.relative_to(around.temporary)
        if home.exists():
            return f"rule files: HOME is an empty folder: name {home} with --checkpoint"
        return ""
    original = Path(around.snapshot.original(text))
    if why := _left_out(original, around):
        return f"rule files: {original} is not in the copy that the policy runs from: {why}"
    if original.exists():
        return _outside(original, around)
    return ""


def _outside(path: Path, around: Surroundings) -> str:
    return (
        f"rule files: {path} is outside of what a policy may read: copy it into {around.policy.parent}, or name it "
        "with --checkpoint"
    )


def _denied(cause: Cause, around: Surroundings) -> str:
    if cause.path:
        path = around.temporary / cause.path
        original = Path(around.snapshot.original(str(path)))
        if cause.number == errno.EPERM or path.is_relative_to(around.temporary):
            return f"rule attributes: mode, owner and times of {original} may not be changed"
        if original != path:
            return f"rule files: {original} may not be written: write to a file in tempfile.gettempdir()"
        if why := _left_out(original, around):
            return f"rule files: {original} is not in the copy that the policy runs from: {why}"
        if any(path.is_relative_to(folder) for folder in around.snapshot.places.values()):
            return f"rule files: a policy runs from a copy: read {path.name} beside __file__, and write nothing there"
        return _outside(path, around)
    if _in(cause.module, _PROCESSES):
        return _NO_PROCESSES
    return _NO_NETWORK if _in(cause.module, _NETWORK) else _NO_CALLS


def _in(module: str, packages: tuple[str, ...]) -> bool:
    return any(module == one or module.startswith(f"{one}.") for one in packages)
