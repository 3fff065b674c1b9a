"""Limits of a policy: memory, disk, processes and time."""

from __future__ import annotations

from dataclasses import dataclass

import psutil

__all__ = ["PolicyLimits"]

_SHARE_OF_MEMORY = 0.75


@dataclass(frozen=True, slots=True)
class PolicyLimits:
    """Limits of a policy.

    Attributes
    ----------
    start_s : float
        From the start of the process until the constructor returned.
    batch_s : float
        For one batch.
    single_s : float
        For one observation of a batch that failed, at most ``batch_s``.
    run_s, observation_s : float
        All waiting for one host together: at most ``run_s``, and ``observation_s`` more for every observation asked.
        After that nothing is asked any more, and every further observation is a time-out.
    log_head_bytes, log_tail_bytes : int
        Kept of the beginning and of the end of what the policy prints.
    deaths_in_row : int
        The observations of a failed batch are asked again one by one. After so many time-outs and deaths in a row the
        rest of the batch counts as faults too.
    memory_bytes : int or None
        Memory; None is three quarters of what the machine has.
    disk_bytes, disk_files : int
        Size of its temporary folder, and how many files and folders may lie in it. No file may be larger than that.
    open_files : int
        Descriptors.
    tasks : int
        Threads and processes beside those that its user has already, where the kernel counts them.
    """

    start_s: float = 120.0
    batch_s: float = 60.0
    single_s: float = 20.0
    run_s: float = 600.0
    observation_s: float = 2.0
    log_head_bytes: int = 256 << 10
    log_tail_bytes: int = 64 << 10
    deaths_in_row: int = 3
    memory_bytes: int | None = None
    disk_bytes: int = 2 << 30
    disk_files: int = 10_000
    open_files: int = 1024
    tasks: int = 1024

    @property
    def memory(self) -> int:
        """Memory that may be used, bytes."""
        return self.memory_bytes or int(_SHARE_OF_MEMORY * psutil.virtual_memory().total)
