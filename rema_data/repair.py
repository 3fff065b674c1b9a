"""Repair hints: for every kind of damage, the command or the edit that fixes it.

A hint is one sentence that ends an error message or a finding. Its commands work as they are printed, in the folder
where the user is; capitals (``PLAN``, ``URL``) stand for what only the user knows.
"""

from __future__ import annotations

import errno
import json
import shlex
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

__all__ = [
    "ReleaseRepair",
    "RepairHint",
    "ask_verify",
    "checkout_command",
    "copy_again",
    "delete",
    "install",
    "reinstall",
    "release_manifest",
    "restore",
    "storage",
    "upgrade",
]

RepairHint = Callable[[Path], str]
"""Hint of an error about a file or folder of a block."""

_COLLECT = "copy {} again from where the release came from, or collect the release again: rema collect PLAN"
_FULL = "free some space or choose another folder, then run the same command again: it resumes"
_CLOSED = "choose another folder, or make this one writable, then run the same command again"
_STORAGE = {
    errno.ENOSPC: _FULL,
    errno.EDQUOT: _FULL,
    errno.EFBIG: "raise the limit (`ulimit -f`), then run the same command again: it resumes",
    errno.EROFS: _CLOSED,
    errno.EACCES: _CLOSED,
    errno.EPERM: _CLOSED,
}


def install(*requirements: str) -> str:
    """For packages that are missing, or installed in a version that does not fit."""
    return "pip install " + " ".join(f'"{item}"' for item in requirements)


def reinstall() -> str:
    """For files that came with the package."""
    return f"pip install --force-reinstall --no-deps {_origin()}"


def upgrade() -> str:
    """For data that a newer version of rema has written."""
    return f"install the version of rema that wrote it: pip install --upgrade {_origin()}"


def restore(path: Path) -> str:
    """For a manifest, or another file that came with the checkout or the package."""
    return checkout_command(path) or copy_again(path)


def copy_again(where: object) -> str:
    """For a file of which nothing is known but its place."""
    return f"copy {where} again from where it came from"


def checkout_command(*paths: Path) -> str | None:
    """The command for files of the package or of a git checkout; None for others."""
    found = [path.parent.resolve() / path.name for path in paths]
    if {"_manifests", "_releases"} & {part for path in found for part in path.parts}:
        return reinstall()
    checkout = next((folder for folder in found[0].parents if (folder / ".git").exists()), None)
    if checkout is None:
        return None
    git = "git" if Path.cwd().resolve() == checkout else f"git -C {shlex.quote(str(checkout))}"
    return f"{git} checkout -- {' '.join(shlex.quote(path.relative_to(checkout).as_posix()) for path in found)}"


def delete(path: Path) -> str:
    """For a file that should not be there."""
    return f"delete it: rm {shlex.quote(str(path))}"


def storage(number: int, variable: str = "") -> str:
    """For a disk that is full or may not be written, by the ``errno`` of the operating system.

    ``variable`` of the environment names the folder, where one does.
    """
    way_out = _STORAGE.get(number)
    if variable and way_out == _FULL:
        return f"free some space and run the same command again: it resumes; or set {variable} to another disk"
    if variable and way_out == _CLOSED:
        return f"set {variable} to a folder that may be written, then run the same command again"
    return _STORAGE.get(number, "choose another folder, then run the same command again")


@dataclass(frozen=True)
class ReleaseRepair:
    """For files of a release: how they come back depends on where they lie, and on whether the release is published."""

    name: str
    root: Path  # the folder of releases
    address: str  # what a command calls the release: its name where that leads to this folder, else the folder
    published: bool
    downloaded: bool
    source: str  # the option that a download needs: empty where a source is known

    @property
    def verify(self) -> str:
        """The command that finds all damage."""
        return f"rema verify {self.address}"

    def file(self, location: str) -> str:
        """The command that brings the sealed bytes of a file, or of a folder of files, back."""
        if self.downloaded:
            return f"{self.verify} --repair{self.source}"
        return self._checkout(location) or (self._published_instead() if self.published else _COLLECT.format("it"))

    @property
    def contents(self) -> str:
        """For contents that were wrong when they were sealed: no other bytes of them exist."""
        if self.published:
            return (
                f"the bytes are the published ones: report it, and use a later release than {self.name}: rema download"
            )
        return "the bytes are the sealed ones: collect the release again under a new name: rema collect PLAN"

    def blocks(self, tasks: Iterable[str], locations: Iterable[str]) -> str:
        """The command that brings missing blocks, by their tasks and folders."""
        options = "".join(f" --task {task}" for task in sorted(set(tasks)))
        if self.downloaded:
            manifest = shlex.quote(str(self.root / self.name / "manifest.json"))
            given = "" if self.published else f" --manifest {manifest}"
            return f"fetch them: rema download {self.name}{options}{given}{self.source}"
        known = self._checkout(*locations)
        if known:
            return f"bring them back: {known}"
        return self._published_instead(options) if self.published else _COLLECT.format("them")

    def at(self, path: Path) -> str:
        """Hint of an error about a file or folder of the release."""
        found = f"find all damage: {self.verify}"
        if not path.is_relative_to(self.root):
            return found
        return f"to fix it: {self.file(path.relative_to(self.root).as_posix())}\n{found}"

    def _published_instead(self, options: str = "") -> str:
        command = f"rema download {self.name}{options}{self.source}"
        return f"fetch the published files, and open them by their name: {command}"

    def _checkout(self, *locations: str) -> str | None:
        if not self.published and self.root.name != "_releases":  # a checkout has no other releases
            return None
        return checkout_command(*(self.root / location for location in locations))


def release_manifest(path: Path, *, published: bool, downloaded: bool) -> str:
    """For the manifest that lies beside the data of a release."""
    if published and downloaded:  # a download without its manifest is resumed where it is
        return f"rm {shlex.quote(str(path))}, and resume the download: rema download {path.resolve().parent.name}"
    return restore(path) if published else copy_again(path)


def ask_verify(path: Path) -> str:
    """For a file of a release that is not known."""
    return "find out how to fix it: `rema verify`, with the name or the folder of the release"


def _origin() -> str:
    """What pip has installed rema from: a clone, a URL, or the name where it was a package index."""
    from importlib import metadata  # takes its time to import

    try:
        recorded = json.loads(metadata.distribution("rema").read_text("direct_url.json") or "{}")
        parts = urlsplit(recorded["url"])
    except (metadata.PackageNotFoundError, ValueError, KeyError):
        return "rema"
    tool = recorded.get("vcs_info", {}).get("vcs")
    url = unquote(parts.path) if parts.scheme == "file" else parts.geturl()
    return shlex.quote(f"{tool}+{url}" if tool else url)
