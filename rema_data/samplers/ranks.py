"""Which part of every global batch this process gets: a wrong answer would train several on the same data."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from typing import Self

from rema_data.errors import InputError
from rema_data.samplers.arguments import whole

__all__ = ["Ranks"]

_GIVE = "or give the sampler rank=... and world_size=..."


@dataclass(frozen=True, slots=True)
class Ranks:
    """Rank and world size, and whether they were given."""

    rank: int
    world_size: int
    given: bool

    @classmethod
    def of(cls, rank: int | None, world_size: int | None) -> Self:
        """As given, else those of ``torch.distributed``, else 0 and 1.

        Raises
        ------
        InputError
            They do not fit together; or they were not given, and this process is one of several but has not joined the
            others yet, or accelerate would deal out the batches a second time.
        """
        if rank is None and world_size is None:
            joined = _joined()
            if joined is None:
                _refuse_apart()
            else:
                _refuse_accelerate(joined[1])
            return cls(*(joined or (0, 1)), given=False)
        if rank is None or world_size is None:
            raise InputError("rank and world_size belong together", hint="give both, or neither")
        world_size = whole("world_size", world_size, 1)
        if whole("rank", rank, 0) >= world_size:
            raise InputError(f"rank {rank} is outside of a world of {world_size}", hint="ranks count from 0")
        return cls(int(rank), world_size, given=True)

    def check(self) -> None:
        """Raise InputError where this process has joined others since the sampler was made."""
        joined = None if self.given else _joined()
        if joined is not None and joined != (self.rank, self.world_size):
            raise InputError(
                f"the sampler was made for rank {self.rank} of {self.world_size}, and this is rank {joined[0]} of "
                f"{joined[1]}",
                hint="make it after torch.distributed.init_process_group() (with Lightning in train_dataloader()), "
                + _GIVE,
            )


def _joined() -> tuple[int, int] | None:
    """Rank and size of the process group of ``torch.distributed``; None without one."""
    distributed = sys.modules.get("torch.distributed")  # a process that uses it has imported it
    if distributed is None or not distributed.is_available() or not distributed.is_initialized():
        return None
    return distributed.get_rank(), distributed.get_world_size()


def _refuse_apart() -> None:
    """Raise InputError where a launcher started several processes, and this one knows of no other."""
    launched = os.environ.get("WORLD_SIZE", "")
    if launched.isdecimal() and int(launched) > 1:
        raise InputError(
            f"WORLD_SIZE is {launched}, but torch.distributed is not initialised: every process would draw the same "
            "batches",
            hint="call torch.distributed.init_process_group() before (with Lightning make the sampler in "
            f"train_dataloader()), {_GIVE}",
            world_size=int(launched),
        )


def _refuse_accelerate(world_size: int) -> None:
    """Raise InputError where accelerate may deal out the batches of a rank once more."""
    state = sys.modules.get("accelerate.state")
    if world_size > 1 and state is not None and state.is_initialized():
        raise InputError(
            "with accelerate it is not clear who deals out the batches: a loader that goes through "
            "accelerator.prepare() is dealt out there, and would be a second time",
            hint="give the sampler rank=0, world_size=1 where the loader is prepared, else "
            "rank=accelerator.process_index, world_size=accelerator.num_processes",
            world_size=world_size,
        )
