"""The seal of an export that is a folder: ``rema/export.json`` names every other file in it, with size and sha256.

::

    grasp/                                  a dataset, in the layout of its format
        ...
        rema/
            export.json                     written last
            manifest.json                   of the exported release
            card/...                        its other files
            round-1/grasp/train/            tables of every block, as they are in the release

The folder gets its name when all of it is written. A folder without a seal is not an export, and one that differs from
its seal is not read.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rema_data.convert.base import Maps
from rema_data.errors import InputError, IntegrityError, MissingFileError, RunMismatchError
from rema_data.interrupts import check
from rema_data.json_files import bounded_file, read_json
from rema_data.new_folder import new_folder, synced_files
from rema_data.release.manifest import Manifest, parse_manifest
from rema_data.repair import upgrade
from rema_data.storage import file_sha256, write_atomic
from rema_data.store.columns import check_version
from rema_data.store.keys import BlockKey
from rema_data.validation import plain, record, validated

__all__ = [
    "AGAIN",
    "OWN",
    "Header",
    "SealedFolder",
    "damaged",
    "find_sealed",
    "format_of",
    "is_sealed",
    "open_sealed",
    "sealed",
]

OWN = "rema"
"""The part of an export that its format does not know."""
AGAIN = "export the release again, or restore the file from a copy"
_SEAL = f"{OWN}/export.json"
_MANIFEST = f"{OWN}/manifest.json"
_CARD = f"{OWN}/card/"
_KIND = "rema export"


@dataclass(frozen=True, slots=True)
class Header:
    """What an export is of: equal headers mean equal exports."""

    format: str
    format_version: int
    schema_version: int
    release: str
    release_sha256: str
    blocks: tuple[str, ...]  # in the order of their episodes
    maps: Maps


@record
class _File:
    path: str
    bytes: int
    sha256: str


@record
class _Seal:
    kind: str
    header: Header
    files: tuple[_File, ...]


@dataclass(frozen=True, slots=True)
class SealedFolder:
    """An export whose files are as they were written."""

    path: Path
    header: Header
    manifest: Manifest
    total_bytes: int

    @property
    def blocks(self) -> list[BlockKey]:
        """Blocks in the order of their episodes."""
        return [BlockKey.parse(path) for path in self.header.blocks]

    @property
    def card(self) -> dict[str, bytes]:
        """Files of the release that belong to no block, by path."""
        folder = self.path / _CARD
        paths = sorted(path for path in folder.rglob("*") if path.is_file())
        return {path.relative_to(folder).as_posix(): _content(path) for path in paths}


def damaged(path: Path, why: str) -> IntegrityError:
    """The error about a file that is not as it was exported."""
    return IntegrityError(
        f"{path} is not as it was exported: {why}",
        hint=AGAIN,
        path=str(path),
    )


@contextmanager
def sealed(path: Path, header: Header, manifest: Manifest, card: dict[str, bytes]) -> Iterator[Path]:
    """A folder to write an export into, which is sealed and becomes ``path`` when the block ends without an error.

    Raises StorageError where the disk is full or may not be written; ``path`` is then not there.
    """
    with new_folder(path) as folder:
        yield folder
        write_atomic(folder / _MANIFEST, manifest.to_bytes())
        for name, data in card.items():
            write_atomic(folder / _CARD / name, data)
        files = tuple(
            _File(file.relative_to(folder).as_posix(), file.stat().st_size, sha256)
            for file, sha256 in synced_files(folder)
        )
        write_atomic(folder / _SEAL, json.dumps(plain(_Seal(_KIND, header, files)), indent=1) + "\n")


def is_sealed(path: Path, header: Header) -> SealedFolder | None:
    """The same export where it is there already; None where nothing is.

    Raises RunMismatchError where another one is in the way, and IntegrityError where it is damaged.
    """
    if not path.exists():
        return None
    if not (path / _SEAL).is_file() or _read_seal(path).header != header:
        raise RunMismatchError(
            f"{path} is there already, and is not this export",
            hint="export into another folder, or move that one away",
            path=str(path),
        )
    return open_sealed(path, header.format, header.format_version)


def format_of(sources: Sequence[Path]) -> str | None:
    """The format of the first sealed export among some folders; None where there is none."""
    for source in sources:
        for folder in _candidates(source):
            if (folder / _SEAL).is_file():
                return _read_seal(folder).header.format
    return None


def find_sealed(sources: Sequence[Path], format: str) -> list[Path]:
    """Folders of exports among some folders, and folders in these.

    Raises MissingFileError where there are none, and InputError for a folder of something else.
    """
    if not sources:
        raise MissingFileError("no folder to import was named", hint="name the folder that `rema export` wrote")
    found: list[Path] = []
    for source in sources:
        inside = [folder for folder in _candidates(source) if (folder / _SEAL).is_file()]
        if not source.is_dir() or not any(source.iterdir()):
            what = "is not a folder" if source.exists() else "does not exist"
            raise MissingFileError(
                f"there is no export in the format {format} to import: {source} "
                f"{'is empty' if source.is_dir() else what}",
                hint="name the folder that `rema export` wrote",
                path=str(source),
            )
        if not inside:
            raise InputError(
                f"{source} was not written by `rema export`: it has no {_SEAL}",
                hint="only exports of releases can be imported; collect new episodes with `rema collect`",
                path=str(source),
            )
        found += inside
    return found


def _candidates(source: Path) -> list[Path]:
    """A folder itself where it is sealed, else the folders in it."""
    if (source / _SEAL).is_file() or not source.is_dir():
        return [source]
    return sorted(folder for folder in source.iterdir() if folder.is_dir() and not folder.name.startswith("."))


def open_sealed(folder: Path, format: str, version: int) -> SealedFolder:
    """An export after a look at every byte of it.

    Raises InputError where it is in another format or version, and IntegrityError where a file is missing or differs.
    """
    seal = _read_seal(folder)
    header = seal.header
    if header.format != format:
        raise InputError(
            f"{folder} is an export in the format {header.format}, not {format}",
            hint=f"rema import --format {header.format}",
            path=str(folder),
        )
    if header.format_version != version:
        raise InputError(
            f"{folder} has format version {header.format_version}, this rema reads {version}",
            hint=upgrade(),
            path=str(folder),
        )
    check_version(header.schema_version, str(folder / _SEAL))
    for path in folder.rglob("*"):
        if path.is_symlink() or not (path.is_file() or path.is_dir()):
            raise damaged(path, "it is a link or a device: an import follows none")
    for file in seal.files:
        check()
        _check(folder / file.path, file)
    listed = {file.path for file in seal.files}
    manifest = parse_manifest(_content(folder / _MANIFEST), str(folder / _MANIFEST))
    known = {block.key.path for block in manifest.blocks}
    if manifest.sha256 != header.release_sha256 or not set(header.blocks) <= known or _MANIFEST not in listed:
        raise damaged(folder / _SEAL, "it names another release than its manifest")
    size = sum(file.bytes for file in seal.files) + (folder / _SEAL).stat().st_size
    return SealedFolder(folder, header, manifest, size)


def _read_seal(folder: Path) -> _Seal:
    path = folder / _SEAL
    try:
        content = read_json(path)
    except (OSError, ValueError) as error:
        raise damaged(path, str(error)) from error
    seal = validated(_Seal, content, str(path), hint=AGAIN, error=IntegrityError)
    if seal.kind != _KIND:
        raise damaged(path, f"it says that it is a {seal.kind!r:.40}")
    for file in seal.files:
        parts = file.path.split("/")
        if "\\" in file.path or ":" in file.path or any(part in ("", ".", "..") for part in parts):
            raise damaged(path, f"it names the file {file.path!r:.80}")
    return seal


def _content(path: Path) -> bytes:
    try:
        return bounded_file(path)
    except (OSError, ValueError) as error:
        raise damaged(path, str(error)) from error


def _check(path: Path, file: _File) -> None:
    try:
        size = path.stat().st_size
        if size != file.bytes:
            raise damaged(path, f"it has {size:,} bytes, not {file.bytes:,}: it is {_how(size, file.bytes)}")
        if file_sha256(path) != file.sha256:
            raise damaged(path, "it has another sha256: it was edited or is damaged")
    except OSError as error:
        raise damaged(path, f"it cannot be read ({error.strerror})") from error


def _how(size: int, expected: int) -> str:
    return "truncated" if size < expected else "edited"
