"""Limits of a policy: memory, disk, processes and time."""

from __future__ import annotations

from dataclasses import dataclass

import psutil

__all__ = ["PolicyLimits"]

_SHARE_OF_MEMORY = 0.75


@dataclass(frozen=True, slots=True)
class PolicyLimits:
    """Limits of a policy."""

    start_s: float = 120.0  # from the start of the process until the constructor returned
    batch_s: float = 60.0  # for one batch, or ``observation_s`` for each of its observations where that is more
    single_s: float = 20.0  # for one observation of a batch that failed, at most ``batch_s``
    # for one host in all, plus ``observation_s`` for every observation asked; after that, each one is a time-out
    run_s: float = 600.0
    observation_s: float = 2.0
    log_head_bytes: int = 256 << 10  # kept of the beginning of what the policy prints
    log_tail_bytes: int = 64 << 10  # and of the end
    # a failed batch is asked one by one; after so many time-outs and deaths in a row, the rest are faults
    deaths_in_row: int = 3
    memory_bytes: int | None = None  # None: three quarters of what the machine has
    disk_bytes: int = 2 << 30  # size of its temporary folder, and of one file
    disk_files: int = 10_000  # files and folders in it
    open_files: int = 1024  # descriptors
    tasks: int = 1024  # threads and processes beside those its user has already, where the kernel counts them

    def seconds(self, observations: int) -> float:
        """How long the answer to so many observations may take, s."""
        return max(self.batch_s, self.observation_s * observations)

    @property
    def memory(self) -> int:
        """Memory that may be used, bytes."""
        return self.memory_bytes or int(_SHARE_OF_MEMORY * psutil.virtual_memory().total)
