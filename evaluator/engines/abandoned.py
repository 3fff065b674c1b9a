"""Robot models (URDF) that a killed simulation left in the folder of temporary files.

The world writes its model into a folder that lives as long as the process. A worker has a temporary folder of its own,
which is removed with it; this is about processes that simulate themselves, and about earlier versions.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

import psutil

__all__ = ["remove_models"]

_PREFIX = "rema-urdf-"
_LIBRARY = "pybullet"


def remove_models() -> None:
    """Remove the models of this user that no simulating process can have made: none is as old as the folder."""
    if not hasattr(psutil.Process, "memory_maps") or not hasattr(os, "getuid"):
        return
    found: list[tuple[Path, float]] = []
    with suppress(OSError), os.scandir(tempfile.gettempdir()) as entries:
        for entry in entries:
            if entry.name.startswith(_PREFIX) and entry.is_dir(follow_symlinks=False):
                about = entry.stat(follow_symlinks=False)
                if about.st_uid == os.getuid():
                    found.append((Path(entry.path), about.st_mtime))
    if not found:
        return
    started = [begin for process in psutil.process_iter() if (begin := _simulates_since(process)) is not None]
    for folder, made in found:
        if not any(begin <= made for begin in started):
            shutil.rmtree(folder, ignore_errors=True)


def _simulates_since(process: psutil.Process) -> float | None:
    """When a process of this user began that has the physics loaded, or may have it."""
    try:
        if process.uids().real != os.getuid():
            return None
        began = float(process.create_time())
        try:
            return began if any(_LIBRARY in Path(item.path).name for item in process.memory_maps()) else None
        except psutil.AccessDenied:  # not known: nothing that it may have made is removed
            return began
    except psutil.Error:
        return None
