"""A new folder appears whole: it is written under another name, and gets its own when all of it is on the disk."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rema_data.interrupts import check
from rema_data.leftovers import temporary_folder
from rema_data.storage import file_sha256, storage_errors, sync_file, sync_folder

__all__ = ["new_folder", "synced_files"]


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A folder to write into, which becomes ``path`` when the block ends without an error; an empty one is replaced.

    Raises StorageError where the disk is full or may not be written; nothing is left then.
    """
    with storage_errors(path), temporary_folder(f".{path.name}.writing-", path.parent) as temporary:
        folder = temporary / path.name
        folder.mkdir()
        yield folder
        if path.exists():
            path.rmdir()
        folder.replace(path)
        sync_folder(path.parent)


def synced_files(folder: Path) -> Iterator[tuple[Path, str]]:
    """Every file below a folder in order, once it is on the disk, and its sha256."""
    for file in sorted(item for item in folder.rglob("*") if item.is_file()):
        check()
        sync_file(file)
        sync_folder(file.parent)
        yield file, file_sha256(file)
