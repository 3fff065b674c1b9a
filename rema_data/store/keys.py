"""Names of blocks. Apart from their readers, so that opening a release loads neither Zarr nor Arrow."""

from __future__ import annotations

from typing import NamedTuple

from rema_data.errors import InputError
from rema_data.schema import TASKS

__all__ = ["SPLITS", "BlockKey"]

SPLITS = ("train", "val")


class BlockKey(NamedTuple):
    """Which block: collection round (from 1), task, and split."""

    round: int
    task: str
    split: str

    @property
    def path(self) -> str:
        """Folder of the block inside its release."""
        return f"round-{self.round}/{self.task}/{self.split}"

    @classmethod
    def parse(cls, path: str) -> BlockKey:
        """Inverse of ``path``; raises InputError where it does not name a block."""
        head, _, rest = path.partition("/")
        task, _, split = rest.partition("/")
        number = head.removeprefix("round-")
        key = cls(int(number), task, split) if number.isdecimal() and number.isascii() else None
        if key is None or key.path != path or task not in TASKS or split not in SPLITS or key.round < 1:
            raise InputError(f"{path!r} is not the name of a block", hint="write it as round-1/grasp/train", path=path)
        return key
