"""Looks through a file of foreign origin in a process of its own, where the HDF5 library may loop or crash.

On some damaged files the library loops for ever inside of a call that nothing interrupts. The time of the processor for
each part is limited, so neither a busy machine nor a large file changes anything; what the library refuses with an
error is left to the reader, who names it.
"""

from __future__ import annotations

import contextlib
import math
import sys
import time
from pathlib import Path
from typing import Any

from rema_data.commands import run_command

__all__ = ["survives"]

_SECONDS = 4
"""Processor time for any part: many times what a whole one takes."""
_PART_BYTES = 48
"""Fewer than a group or an array takes: a file in which the library finds more parts leads it in circles."""


def survives(path: Path) -> bool:
    """Whether the library comes to an end with all names, attributes and addresses of a file."""
    command = [sys.executable, "-m", "rema_data.convert.hdf5_probe", str(path)]
    return run_command(command).returncode == 0


class _Circle(BaseException):
    """More parts than the file has room for; no library catches it."""


class _Look:
    """Looks at parts, with a limit of time for each of them."""

    def __init__(self, most: int) -> None:
        self._left = most
        self.another()

    def another(self) -> None:
        """Let another few seconds be spent from now on."""
        with contextlib.suppress(ImportError):  # Windows has no such limits
            import resource

            spent = math.ceil(time.process_time())
            resource.setrlimit(resource.RLIMIT_CPU, (spent + _SECONDS, resource.getrlimit(resource.RLIMIT_CPU)[1]))

    def __call__(self, name: str, item: Any) -> None:
        self.another()
        self._left -= 1
        if self._left < 0:
            raise _Circle
        with contextlib.suppress(Exception):
            for attribute in item.attrs:
                with contextlib.suppress(Exception):
                    item.attrs[attribute]
            if hasattr(item, "chunks") and item.chunks:
                item.id.chunk_iter(lambda chunk: None)


def _main(path: Path) -> None:
    with contextlib.suppress(ImportError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    look = _Look(path.stat().st_size // _PART_BYTES)
    import h5py

    with contextlib.suppress(Exception), h5py.File(path, "r") as file:
        look("/", file)
        file.visititems(look)


if __name__ == "__main__":
    _main(Path(sys.argv[1]))
