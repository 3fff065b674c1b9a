"""Memory and disk of a policy, measured from outside while the evaluator waits, where the kernel keeps no limit."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import psutil

from evaluator.policy.sandbox.limits import PolicyLimits

__all__ = ["ResourceMonitor"]

_BLOCK = 512  # bytes of st_blocks, on every file system
_MEMORY = ("VmRSS:", "VmSwap:", "VmPTE:")


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
            folder = folders.pop()
            try:
                with os.scandir(folder) as found:
                    entries = list(found)
            except (FileNotFoundError, NotADirectoryError):
                continue  # it was removed meanwhile
            except OSError as error:
                return f"it made a folder in its temporary folder that cannot be measured ({error.strerror})"
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
        """Bytes of files that were removed and are still open, or still mapped."""
        sizes: dict[tuple[int, int], int] = {}
        with suppress(OSError):
            for name in os.listdir(f"/proc/{self._pid}/fd"):
                with suppress(OSError):
                    found = os.stat(f"/proc/{self._pid}/fd/{name}")
                    if found.st_nlink == 0:
                        sizes[found.st_dev, found.st_ino] = found.st_blocks * _BLOCK
        with suppress(OSError, ValueError):
            for line in Path(f"/proc/{self._pid}/maps").read_text(errors="replace").splitlines():
                if line.endswith(" (deleted)") and str(self._folder) in line:
                    place, _, _, device, inode, *_ = line.split(maxsplit=5)
                    major, minor = (int(part, 16) for part in device.split(":"))
                    start, end = (int(part, 16) for part in place.split("-"))
                    sizes.setdefault((os.makedev(major, minor), int(inode)), end - start)
        return sum(sizes.values())

    def _excess_of_memory(self) -> str | None:
        used = 0
        with suppress(psutil.Error):
            process = psutil.Process(self._pid)
            for member in (process, *process.children(recursive=True)):
                with suppress(OSError):
                    used += _memory(Path(f"/proc/{member.pid}/status").read_text())
        if used <= self._limits.memory:
            return None
        return f"it used {_gib(used)} of memory (limit {_gib(self._limits.memory)})"


def _memory(status: str) -> int:
    """Bytes of a process in memory and in swap, and of the tables that map them."""
    lines = (line.split() for line in status.splitlines())
    return sum(1024 * int(words[1]) for words in lines if words and words[0] in _MEMORY)


def _gib(count: int) -> str:
    return f"{count / (1 << 30):.2f} GiB"
