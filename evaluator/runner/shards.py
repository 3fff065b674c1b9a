"""The scenarios of one of several runs that together are one evaluation: ``--shard 2/8``."""

from __future__ import annotations

import re
from dataclasses import dataclass

from rema_data.errors import InputError

__all__ = ["RunShard"]

_FORM = re.compile(r"(\d+)/(\d+)")


@dataclass(frozen=True, slots=True)
class RunShard:
    """Shard ``number`` (from 1) of ``count`` of the scenarios of a run."""

    number: int
    count: int

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.count:
            raise InputError(f"there is no shard {self}", hint="count from 1: --shard 1/8 to --shard 8/8")

    @classmethod
    def parse(cls, text: str) -> RunShard:
        """The shard that ``2/8`` means; an InputError where there is no such shard."""
        found = _FORM.fullmatch(text)
        if found is None:
            raise InputError(f"{text!r} is not a shard", hint="write number/count: --shard 2/8", text=text)
        return cls(int(found[1]), int(found[2]))

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def indices(self, episodes: int, batch_size: int) -> range:
        """Scenarios of this shard: whole batches, so that a policy is asked the same questions as in one run.

        The shards of one ``count`` are disjoint and cover all scenarios; none is empty: an InputError where there are
        more shards than batches.
        """
        batches = -(-episodes // batch_size)
        if self.count > batches:
            raise InputError(
                f"{episodes:,} episodes are {batches:,} batches of {batch_size}, too few for {self.count:,} shards",
                hint=f"make {batches:,} shards or less, or give a smaller --batch-size to all of them",
                batches=batches,
            )
        start, stop = (batches * number // self.count * batch_size for number in (self.number - 1, self.number))
        return range(start, min(stop, episodes))
