"""The folders that rema uses: its home, and the releases that are here."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rema_data.errors import RemaError
from rema_data.release.folder import ReleaseFolder, downloads_folder, local_sources
from rema_data.release.manifest import MANIFEST, parse_manifest
from rema_data.release.registry import load_published, published
from rema_data.storage import rema_home

__all__ = ["Home", "ReleaseState", "home", "local_releases"]


@dataclass(frozen=True, slots=True)
class Home:
    """The folder of everything that can be fetched or built again.

    Attributes
    ----------
    path : str
    writable : bool
        Files can be created there.
    free_bytes : int
        On its disk.
    """

    path: str
    writable: bool
    free_bytes: int


@dataclass(frozen=True)
class ReleaseState:
    """A release on this machine.

    Attributes
    ----------
    name, path : str
    identity : str
        ``published``, ``not published``, ``not the published one``, or why the manifest cannot be read.
    blocks, blocks_total : int
        Blocks that are here whole, and blocks of the release.
    bytes : int
        Of the files that are here.
    folder : ReleaseFolder or None
        None where the manifest cannot be read.
    """

    name: str
    path: str
    identity: str
    blocks: int
    blocks_total: int
    bytes: int
    folder: ReleaseFolder | None

    @property
    def ok(self) -> bool:
        """Whether the release is what its name says."""
        return self.identity in ("published", "not published")


def home() -> Home:
    """The state of ``REMA_HOME``."""
    path = rema_home()
    there = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
    return Home(str(path), there.is_dir() and os.access(there, os.W_OK | os.X_OK), shutil.disk_usage(there).free)


def local_releases() -> tuple[ReleaseState, ...]:
    """Releases in the folders where rema looks for them; the published ones in the order of their publication."""
    index = {entry.name: entry.sha256 for entry in published()}
    found = []
    for root in dict.fromkeys(path.resolve() for path in (downloads_folder(), *local_sources()) if path.is_dir()):
        names = {path.parent.name for path in root.glob(f"*/{MANIFEST}")}
        names |= {name for name in index if (root / name).is_dir()}
        found += [_release_state(root, name, index.get(name)) for name in names]
    order = list(index)
    return tuple(sorted(found, key=lambda state: (state.name not in index, _position(order, state.name), state.path)))


def _position(order: Sequence[str], name: str) -> int:
    return order.index(name) if name in order else len(order)


def _release_state(root: Path, name: str, known: str | None) -> ReleaseState:
    path = root / name / MANIFEST
    try:
        manifest = parse_manifest(path.read_bytes(), str(path)) if path.is_file() else load_published(name)
    except RemaError as error:
        return ReleaseState(name, str(root / name), error.message, 0, 0, 0, None)
    identity = "published" if manifest.sha256 == known else "not published"
    if known not in (None, manifest.sha256) or manifest.name != name:
        identity = "not the published one" if manifest.name == name else f"the folder of {manifest.name}, renamed"
    folder = ReleaseFolder(manifest, root)
    here = sum(file.bytes for file in manifest.files if folder.has(file))
    return ReleaseState(name, str(root / name), identity, len(folder.blocks()), len(manifest.blocks), here, folder)
