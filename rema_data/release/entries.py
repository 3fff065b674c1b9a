"""What a manifest lists: files, blocks and the parent release. Each entry checks itself when it is made."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, ClassVar

from rema_data.errors import InputError
from rema_data.schema import TASK_NUMBERS
from rema_data.store.keys import BlockKey

__all__ = ["BlockEntry", "FileEntry", "Parent", "StrictRecord", "block_order", "check_holder", "check_name"]

_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")
_SHA = re.compile(r"[0-9a-f]{64}")


def check_name(name: str) -> str:
    """``name`` itself, or an InputError where it cannot name a release (and so a folder)."""
    if not _NAME.fullmatch(name) or ".." in name:
        raise InputError(
            f"{name!r} cannot name a release",
            hint="use lower-case letters, digits, dots, dashes and underscores, such as rema-mini",
            name=name,
        )
    return name


def check_holder(name: str) -> None:
    """Raise ValueError where a name cannot be that of a release."""
    try:
        check_name(name)
    except InputError as error:
        raise ValueError(error.message) from error


class StrictRecord:
    """How pydantic reads the records of a manifest. They are plain dataclasses, to be made without pydantic too."""

    __slots__ = ()
    __pydantic_config__: ClassVar[Any] = {"extra": "forbid", "strict": True}


@dataclass(frozen=True, slots=True)
class FileEntry(StrictRecord):
    """One file of a release."""

    path: str  # inside the folder of its holder, with forward slashes
    bytes: int
    sha256: str
    holder: str  # name of the release in whose folder the file lies

    def __post_init__(self) -> None:
        parts = self.path.split("/")
        climbs = any(part in ("", ".", "..") for part in parts)
        if climbs or "\\" in self.path or ":" in self.path or not self.path.isprintable() or len(self.path) > 512:
            raise ValueError(f"the path {self.path!r} does not stay inside the release")
        if self.bytes < 0:
            raise ValueError(f"bytes is {self.bytes}")
        if not _SHA.fullmatch(self.sha256):
            raise ValueError(f"{self.path} has the sha256 {self.sha256!r}")
        check_holder(self.holder)

    @property
    def location(self) -> str:
        """Path below a folder of releases, and below a mirror's URL."""
        return f"{self.holder}/{self.path}"

    @property
    def block(self) -> str | None:
        """Path of the block that the file belongs to, or None for one of the whole release."""
        parts = self.path.split("/")
        return "/".join(parts[:3]) if parts[0].startswith("round-") and len(parts) > 3 else None


@dataclass(frozen=True, slots=True)
class BlockEntry(StrictRecord):
    """What a block holds."""

    round: int
    task: str
    split: str
    episodes: int
    steps: int
    end_effectors: int  # different end-effector maps
    positives: int  # episodes that succeeded
    policies: tuple[str, ...]  # behaviour policy of every step of the task, in order
    holder: str  # release in whose folder the block lies

    def __post_init__(self) -> None:
        for name in ("episodes", "steps", "end_effectors", "positives"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name)}")
        check_holder(self.holder)

    @property
    def key(self) -> BlockKey:
        """Which block it is."""
        return BlockKey(self.round, self.task, self.split)


@dataclass(frozen=True, slots=True)
class Parent(StrictRecord):
    """The release that this one continues."""

    name: str
    sha256: str

    def __post_init__(self) -> None:
        check_holder(self.name)
        if not _SHA.fullmatch(self.sha256):
            raise ValueError(f"the parent {self.name} has the sha256 {self.sha256!r}")


def block_order(block: BlockEntry) -> tuple[int, int, str]:
    """Sort key of the blocks of a manifest."""
    return block.round, TASK_NUMBERS[block.task], block.split
