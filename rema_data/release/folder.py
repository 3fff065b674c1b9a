"""Releases on this machine: where their files lie, and which blocks are there."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rema_data.errors import InputError, IntegrityError, MissingFileError, RemaError
from rema_data.release.manifest import MANIFEST, BlockEntry, FileEntry, Manifest, parse_manifest
from rema_data.release.registry import load_published, preferred, published
from rema_data.repair import ReleaseRepair, release_manifest
from rema_data.storage import absolute, rema_home

if TYPE_CHECKING:
    from rema_data.store.block import BlockReader

__all__ = ["ReleaseFolder", "downloads_folder", "find_release", "local_sources"]

_MORE_ROWS = 1000
"""How many more rows than twice those of the manifest a table may have and be read, so that a check can name them."""


@dataclass(frozen=True)
class ReleaseFolder:
    """A release whose files lie below ``root``."""

    manifest: Manifest
    root: Path  # the folder of releases: a file is at ``root / holder / path``
    renamed: str | None = None  # name of the release's own folder in ``root``, where that is not the release's

    def __post_init__(self) -> None:
        object.__setattr__(self, "root", absolute(self.root))

    @property
    def path(self) -> Path:
        """The release's own folder."""
        return self._folder(self.manifest.name)

    def _folder(self, holder: str) -> Path:
        return self.root / (self.renamed if self.renamed and holder == self.manifest.name else holder)

    def file(self, entry: FileEntry) -> Path:
        """Where a file lies."""
        return self._folder(entry.holder) / entry.path

    def has(self, entry: FileEntry) -> bool:
        """Whether a file is there with its size. Its content is checked when it is decoded, and by ``rema verify``."""
        try:
            return os.stat(self.file(entry)).st_size == entry.bytes
        except OSError:
            return False

    def block(self, entry: BlockEntry) -> BlockReader:
        """Reader of a block."""
        from rema_data.store.block import BlockReader

        most = (2 * count + _MORE_ROWS for count in (entry.episodes, entry.steps))
        return BlockReader(self._folder(entry.holder) / entry.key.path, self._repair_hint, *most)

    def blocks(self) -> tuple[BlockEntry, ...]:
        """The blocks that are here whole."""
        files = [file for file in self.manifest.files if file.block is not None]
        missing = {file.block for file in files if not self.has(file)}
        return tuple(block for block in self.manifest.blocks if block.key.path not in missing)

    def require(self, wanted: Iterable[BlockEntry]) -> None:
        """Raise MissingFileError, with the command that fetches them, where blocks are not here whole."""
        here = {block.key for block in self.blocks()}
        missing = [block for block in wanted if block.key not in here]
        if missing:
            raise MissingFileError(
                f"{len(missing)} blocks of {self.manifest.name} are missing or not whole on this machine, "
                f"the first one {missing[0].key.path}",
                hint=self.missing_hint(missing),
                missing=[block.key for block in missing],
            )

    def missing_hint(self, missing: Sequence[BlockEntry]) -> str:
        """The command that brings missing blocks."""
        locations = [f"{block.holder}/{block.key.path}" for block in missing]
        return self.repair.blocks([block.task for block in missing], locations)

    @property
    def downloaded(self) -> bool:
        """Whether the release lies where ``rema download`` puts it."""
        return self.renamed is None and _is_downloads(self.root)

    def _repair_hint(self, path: Path) -> str:
        return self.repair.at(path)

    @property
    def repair(self) -> ReleaseRepair:
        """The commands that bring its files back."""
        manifest, root = self.manifest, self.root.resolve()
        # The commands know a release by its name, and so do its folder in a checkout and in the downloads.
        is_published = self.renamed is None and manifest.sha256 in published().values()
        try:
            by_name = is_published and find_release(manifest.name).root.resolve() == root
        except RemaError:
            by_name = False
        others = [folder for folder in local_sources() if folder.resolve() != root]
        has_source = manifest.sources or any((folder / manifest.name).is_dir() for folder in others)
        return ReleaseRepair(
            manifest.name,
            self.root,
            manifest.name if by_name else shlex.quote(str(root / (self.renamed or manifest.name))),
            is_published,
            self.downloaded,
            "" if has_source else " --source URL",
        )


def downloads_folder() -> Path:
    """Where downloaded releases lie: ``REMA_HOME/releases``."""
    return rema_home() / "releases"


def _is_downloads(root: Path) -> bool:
    return root.resolve() == downloads_folder().resolve()


def local_sources() -> tuple[Path, ...]:
    """Folders of releases that come with the package or the checkout: the sample, and the shards of a clone."""
    package = Path(__file__).resolve().parent.parent
    candidates = (package / "_releases", package.parent / "releases", Path.cwd() / "releases")
    return tuple(dict.fromkeys(folder for folder in candidates if folder.is_dir()))


def find_release(name_or_path: str | os.PathLike[str] | None = None) -> ReleaseFolder:
    """The release of a published name, or in a folder; by default the newest published one that is on this machine.

    Raises InputError for an unknown name, MissingFileError where it is not on this machine or the folder has no
    release, and IntegrityError where its manifest is damaged or not the published one.
    """
    if name_or_path is None:
        return _find_default()
    text = os.fspath(name_or_path)
    if text not in published():
        folder = Path(os.path.expanduser(text))
        if not folder.is_dir():
            raise InputError(
                f"{text!r} is neither a published release nor a folder",
                hint=f"published releases: {', '.join(sorted(published()))}",
            )
        path = _manifest_in(folder)
        if not path.is_file():
            raise MissingFileError(
                f"{folder} has no {MANIFEST}: it is not the folder of a sealed release",
                hint="name the folder that `rema collect`, `rema download` or `rema publish` made",
                path=str(path),
            )
        manifest, place = _parse_beside_data(path), path.parent.resolve()
        return ReleaseFolder(manifest, place.parent, None if place.name == manifest.name else place.name)
    manifest = load_published(text)
    found = [ReleaseFolder(manifest, root) for root in (downloads_folder(), *local_sources())]
    best = max(found, key=lambda folder: len(folder.blocks()))
    if not best.blocks():
        raise MissingFileError(f"release {text} is not on this machine", hint=f"fetch it: rema download {text}")
    return best


def _manifest_in(folder: Path) -> Path:
    """Its own manifest, or that of the only release in it: `rema publish` writes a folder of releases."""
    inside = [] if (folder / MANIFEST).exists() else sorted(folder.glob(f"*/{MANIFEST}"))
    return inside[0] if len(inside) == 1 else folder / MANIFEST


def _parse_beside_data(path: Path) -> Manifest:
    try:
        return parse_manifest(path.read_bytes(), str(path))
    except IntegrityError as error:
        root, name = path.resolve().parents[1], path.resolve().parent.name
        error.hint = release_manifest(path, published=name in published(), downloaded=_is_downloads(root))
        raise


def _find_default() -> ReleaseFolder:
    """The first of ``preferred`` that is here."""
    for name in preferred():
        try:
            return find_release(name)
        except MissingFileError:
            continue
    raise MissingFileError("no release is on this machine", hint="fetch the newest one: rema download")
