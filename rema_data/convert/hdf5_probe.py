"""Looks through a file of foreign origin in a process of its own, where the HDF5 library may loop or crash.

On some damaged files the library loops for ever inside of a call that nothing interrupts. The time of the processor is
limited, so a busy machine changes nothing; what the library refuses with an error is left to the reader, who names it.
"""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import Any

from rema_data.commands import run_command

__all__ = ["survives"]

_SECONDS, _BYTES_A_SECOND = 4, 10_000_000
"""Processor time for any file, and for each second more of it so many bytes: many times what a whole file takes."""


def survives(path: Path) -> bool:
    """Whether the library comes to an end with all names, attributes and addresses of a file."""
    seconds = _SECONDS + path.stat().st_size // _BYTES_A_SECOND
    command = [sys.executable, "-m", "rema_data.convert.hdf5_probe", str(path), str(seconds)]
    return run_command(command).returncode >= 0  # negative: ended by a signal


def _look(name: str, item: Any) -> None:
    with contextlib.suppress(Exception):
        for attribute in item.attrs:
            with contextlib.suppress(Exception):
                item.attrs[attribute]
        if hasattr(item, "chunks") and item.chunks:
            item.id.chunk_iter(lambda chunk: None)


def _main(path: str, seconds: int) -> None:
    with contextlib.suppress(ImportError):  # Windows has no such limits
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    import h5py

    with contextlib.suppress(Exception), h5py.File(path, "r") as file:
        _look("/", file)
        file.visititems(_look)


if __name__ == "__main__":
    _main(sys.argv[1], int(sys.argv[2]))
