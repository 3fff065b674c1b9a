"""The command that brings damaged or missing files of a release back: in one place."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path

from rema_data.errors import RemaError
from rema_data.release.folder import ReleaseFolder, downloads_folder, find_release, local_sources
from rema_data.release.manifest import MANIFEST
from rema_data.release.registry import published
from rema_data.store.keys import BlockKey

__all__ = ["RepairHints", "is_download", "manifest_repair"]

_AGAIN = "copy it again from where the release came from, or collect the release again: rema collect PLAN"
_REINSTALL = "pip install --force-reinstall rema"


def is_download(release: ReleaseFolder) -> bool:
    """Whether the release lies where ``rema download`` puts it."""
    return _is_downloads(release.root)


class RepairHints:
    """How the files of a release come back, which depends on where they lie and whether the release is published.

    Parameters
    ----------
    release : ReleaseFolder
    """

    def __init__(self, release: ReleaseFolder) -> None:
        self._release = release

    @cached_property
    def published(self) -> bool:
        """Whether this very release is published, and not only one of its name."""
        return any(entry.sha256 == self._release.manifest.sha256 for entry in published())

    @cached_property
    def address(self) -> str:
        """What a command calls the release: its name where that leads to this folder, else the folder."""
        name, root = self._release.manifest.name, self._release.root.resolve()
        try:
            if self.published and find_release(name).root.resolve() == root:
                return name
        except RemaError:
            pass
        return shlex.quote(str(root / name))

    @property
    def verify(self) -> str:
        """The command that finds all damage."""
        return f"rema verify {self.address}"

    def file(self, location: str) -> str:
        """The command that brings the sealed bytes of a file, or of a folder of files, back."""
        root = self._release.root.resolve()
        if is_download(self._release):
            return f"{self.verify} --repair{self._source}"
        known = _from_known_place(root, (location,), self.published)
        if known is not None:
            return known
        return self._published_instead() if self.published else _AGAIN

    def blocks(self, keys: Iterable[BlockKey]) -> str:
        """The command that brings missing blocks."""
        missing, manifest = set(keys), self._release.manifest
        options = "".join(f" --task {task}" for task in sorted({key.task for key in missing}))
        if is_download(self._release):
            given = "" if self.published else f" --manifest {shlex.quote(str(self._release.path / MANIFEST))}"
            return f"fetch them: rema download {manifest.name}{options}{given}{self._source}"
        locations = [f"{block.holder}/{block.key.path}" for block in manifest.blocks if block.key in missing]
        known = _from_known_place(self._release.root.resolve(), locations, self.published)
        if known is not None:
            return f"bring them back: {known}"
        if self.published:
            return self._published_instead(options)
        return _AGAIN.replace("it", "them", 1)

    def at(self, path: Path) -> str:
        """Hint of an error about a file or folder of the release."""
        try:
            location = path.relative_to(self._release.root).as_posix()
        except ValueError:
            return f"find all damage: {self.verify}"
        return f"to fix it: {self.file(location)}\nfind all damage: {self.verify}"

    def _published_instead(self, options: str = "") -> str:
        command = f"rema download {self._release.manifest.name}{options}{self._source}"
        return f"fetch the published files, and open them by their name: {command}"

    @property
    def _source(self) -> str:
        """The option that a download needs where nothing is known from which it could come."""
        manifest, root = self._release.manifest, self._release.root.resolve()
        others = [folder for folder in local_sources() if folder.resolve() != root]
        if manifest.sources or any((folder / manifest.name).is_dir() for folder in others):
            return ""
        return " --source URL"


def manifest_repair(path: Path) -> str:
    """The command that brings back a manifest that lies beside the data and cannot be read.

    Parameters
    ----------
    path : Path
        Of the manifest, in the release's own folder.
    """
    root, name = path.resolve().parents[1], path.resolve().parent.name
    known = name in {entry.name for entry in published()}
    if known and _is_downloads(root):
        # Without its manifest a download goes on where it stopped; and the name may lead to a copy elsewhere.
        return f"rm {shlex.quote(str(path))}, and go on with its download: rema download {name}"
    command = _from_known_place(root, (f"{name}/{MANIFEST}",), known)
    return command or f"copy {path} again from where the release came from"


def _is_downloads(root: Path) -> bool:
    return root.resolve() == downloads_folder().resolve()


def _from_known_place(root: Path, locations: Iterable[str], known: bool) -> str | None:
    """The command for files that came with the package, or with a checkout that has published releases."""
    if root.name == "_releases":
        return _REINSTALL
    checkout = next((folder for folder in root.parents if (folder / ".git").exists()), None)
    if not known or checkout is None:
        return None
    git = "git" if Path.cwd().resolve() == checkout else f"git -C {shlex.quote(str(checkout))}"
    paths = [shlex.quote((root / location).relative_to(checkout).as_posix()) for location in locations]
    return f"{git} checkout -- {' '.join(paths)}"
