"""Memory and disk of a policy, measured from outside while the evaluator waits: the kernel limits only files."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import psutil

from evaluator.policy.sandbox.limits import PolicyLimits

__all__ = ["ResourceMonitor"]

_BLOCK = 512  # bytes of st_blocks, on every file system


class ResourceMonitor:
    """Compares the memory of a process and its descendants, and its temporary folder, with the limits."""

    def __init__(self, pid: int, folder: Path, limits: PolicyLimits) -> None:
        self._pid, self._folder, self._limits = pid, folder, limits

    def excess(self) -> str | None:
        """The limit that is exceeded, in words, or None."""
        return self.excess_of_disk() or self._excess_of_memory()

    def excess_of_disk(self) -> str | None:
        """As ``excess``, of the temporary folder alone."""
        size, count, folders = 0, 0, [str(self._folder)]
        while folders:
            with suppress(OSError), os.scandir(folders.pop()) as entries:
                for entry in entries:
                    count += 1
                    if count > self._limits.disk_files:
                        return f"it made more than {self._limits.disk_files:,} files in its temporary folder"
                    with suppress(OSError):
                        size += entry.stat(follow_symlinks=False).st_blocks * _BLOCK
                        if entry.is_dir(follow_symlinks=False):
                            folders.append(entry.path)
        size += self._unlinked()
        if size <= self._limits.disk_bytes:
            return None
        return f"it filled its temporary folder with {_gib(size)} (limit {_gib(self._limits.disk_bytes)})"

    def _unlinked(self) -> int:
        """Bytes of files that were removed but are still open."""
        size = 0
        with suppress(OSError):
            for name in os.listdir(f"/proc/{self._pid}/fd"):
                with suppress(OSError):
                    found = os.stat(f"/proc/{self._pid}/fd/{name}")
                    size += found.st_blocks * _BLOCK if found.st_nlink == 0 else 0
        return size

    def _excess_of_memory(self) -> str | None:
        used = 0
        with suppress(psutil.Error):
            process = psutil.Process(self._pid)
            for member in (process, *process.children(recursive=True)):
                with suppress(psutil.Error):
                    used += member.memory_info().rss
        if used <= self._limits.memory:
            return None
        return f"it used {_gib(used)} of memory (limit {_gib(self._limits.memory)})"


def _gib(count: int) -> str:
    return f"{count / (1 << 30):.2f} GiB"
