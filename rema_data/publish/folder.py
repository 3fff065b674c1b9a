"""A folder that is published: it appears whole, with the sha256 of each of its files in ``SHA256SUMS``."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rema_data.errors import InputError, RunMismatchError
from rema_data.new_folder import new_folder, synced_files
from rema_data.storage import absolute, storage_errors, write_atomic

__all__ = ["CHECKSUMS", "Published", "check_repository", "publication", "whole_folder"]

CHECKSUMS = "SHA256SUMS"
"""What ``sha256sum --check`` reads."""
_ATTRIBUTES = """\
* -text
*.parquet filter=lfs diff=lfs merge=lfs -text
*.safetensors filter=lfs diff=lfs merge=lfs -text
**/maps.zarr/*/c/** filter=lfs diff=lfs merge=lfs -text
"""
"""For git: no byte is changed, and large files are kept outside of the history."""
_REPOSITORY = re.compile(r"\w[\w.-]*/\w[\w.-]*", re.ASCII)


@dataclass(frozen=True, slots=True)
class Published:
    """A folder that was written."""

    path: Path
    kind: str  # of the repository that it is for: ``dataset`` or ``model``
    files: int
    bytes: int


def check_repository(name: str) -> str:
    """The name of a repository, ORG/NAME; InputError where it cannot be one."""
    if not _REPOSITORY.fullmatch(name):
        raise InputError(f"{name!r:.80} is not the name of a repository", hint="name it as on the hub: --repo ORG/NAME")
    return name


@contextmanager
def whole_folder(path: Path, option: str = "--to") -> Iterator[Path]:
    """A folder to write into, which becomes ``path`` when the block ends without an error.

    Raises RunMismatchError where ``path`` holds something (``option`` names another), and StorageError where the disk
    is full or may not be written; nothing is left then.
    """
    path = absolute(path)
    with storage_errors(path):
        taken = path.exists() and (not path.is_dir() or any(path.iterdir()))
    if taken:
        raise RunMismatchError(
            f"{path} is there already: this is written into a new folder",
            hint=f"choose another folder with {option}, or move that one away",
            path=str(path),
        )
    with new_folder(path) as folder:
        yield folder


@contextmanager
def publication(path: Path) -> Iterator[Path]:
    """``whole_folder``, with the checksums of everything that was written into it."""
    with whole_folder(path) as folder:
        yield folder
        write_atomic(folder / ".gitattributes", _ATTRIBUTES)
        lines = [f"{sha256}  {file.relative_to(folder).as_posix()}\n" for file, sha256 in synced_files(folder)]
        write_atomic(folder / CHECKSUMS, "".join(lines))
