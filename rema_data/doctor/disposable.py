"""What can be built or fetched again: decoded caches, and files that were being downloaded."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from rema_data.doctor.releases import ReleaseState
from rema_data.download.part import SUFFIX
from rema_data.loader.cache import cache_name, caches_folder
from rema_data.loader.record import damaged_files, is_whole
from rema_data.locks import Busy, lock
from rema_data.release.folder import downloads_folder
from rema_data.storage import storage_errors

__all__ = ["PARTIAL", "READY", "Disposable", "disposables", "prune"]

READY, OLD, ORPHAN, DAMAGED, UNFINISHED, PARTIAL = "ready", "old", "orphan", "damaged", "unfinished", "partial"


@dataclass(frozen=True, slots=True)
class Disposable:
    """A decoded cache, or a file that was being downloaded.

    The state of a cache is ``ready``; ``old`` (other blocks of the release are here now), ``orphan`` (of no release
    that is found here), ``damaged``, or ``unfinished`` (a process builds it, or was killed). A download is ``partial``.
    """

    path: str
    release: str  # that it belongs to; empty where no release here has it
    state: str
    bytes: int
    lock: str  # the lock file that a process holds while it works on it
    damaged: tuple[str, ...] = ()  # files of a cache whose content was checked and has changed


def disposables(releases: Iterable[ReleaseState], contents: bool = False) -> tuple[Disposable, ...]:
    """Decoded caches and partial downloads below ``REMA_HOME``; ``contents`` reads every byte of the ready caches."""
    ready, names = {}, {}
    for state in releases:
        if state.folder is not None:
            names[state.folder.manifest.sha256[:16]] = state.name
            ready[cache_name(state.folder, state.folder.blocks())] = state.name
    caches, downloads = caches_folder(), downloads_folder()
    folders = sorted(path for path in caches.iterdir() if path.is_dir()) if caches.is_dir() else []
    parts = sorted(downloads.glob(f"*/**/*{SUFFIX}")) if downloads.is_dir() else []
    return (*(_cache(path, ready, names, contents) for path in folders), *(_partial(path, downloads) for path in parts))


def _cache(path: Path, ready: dict[str, str], names: dict[str, str], contents: bool) -> Disposable:
    name = path.name.removeprefix(".").partition(".")[0]
    release = names.get(name.partition("-")[0], "")
    if path.name.startswith("."):
        state = UNFINISHED
    elif not is_whole(path):
        state = DAMAGED
    elif path.name in ready:
        state = READY
    else:
        state = OLD if release else ORPHAN
    wrong = damaged_files(path) if contents and state == READY else ()
    if wrong:
        state = DAMAGED
    size = sum(file.stat().st_size for file in path.iterdir() if file.is_file())
    return Disposable(str(path), release, state, size, str(path.parent / f"{name}.lock"), wrong)


def _partial(path: Path, downloads: Path) -> Disposable:
    holder = path.relative_to(downloads).parts[0]
    return Disposable(str(path), holder, PARTIAL, path.stat().st_size, str(downloads / f".{holder}.lock"))


def prune(found: Iterable[Disposable]) -> tuple[Disposable, ...]:
    """Delete all but the ready caches and what a running process works on; what was deleted.

    Raises StorageError where something may not be deleted.
    """
    deleted = []
    for item in found:
        if item.state == READY:
            continue
        path = Path(item.path)
        try:
            with storage_errors(path), lock(Path(item.lock)):
                if path.is_dir():
                    shutil.rmtree(path)
                else:
                    path.unlink(missing_ok=True)
        except Busy:
            continue
        deleted.append(item)
    return tuple(deleted)
