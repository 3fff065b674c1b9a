"""``download``: a release, or a part of it, into ``REMA_HOME/releases``."""

from __future__ import annotations

import logging
import os
import shlex
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path

from rema_data.download.plan import DownloadReport, Plan, check_space, make_plan
from rema_data.download.pool import Outcome, fetch_files
from rema_data.download.sources import Source
from rema_data.errors import InputError, IntegrityError, MissingFileError, RunMismatchError
from rema_data.locks import LOCAL_HOME, lock
from rema_data.progress import Progress, Silent
from rema_data.release.folder import ReleaseFolder, downloads_folder, local_sources
from rema_data.release.manifest import MANIFEST, Manifest, parse_manifest
from rema_data.release.registry import load_published, newest, published
from rema_data.storage import absolute, storage_errors, write_atomic

__all__ = ["download", "fetch_again"]

JOBS = 8
_LISTED = 5
"""So many reasons why files could not be fetched are named in the error."""
_LOG = logging.getLogger(__name__)


def download(
    release: str | None = None,
    tasks: Iterable[str] | None = None,
    rounds: Iterable[int] | None = None,
    split: str | None = None,
    sources: Sequence[str | os.PathLike[str]] = (),
    jobs: int | None = None,
    offline: bool = False,
    dry_run: bool = False,
    progress: Progress | None = None,
    manifest: str | os.PathLike[str] | None = None,
    verify: bool = False,
) -> DownloadReport:
    """Bring a release, or a part of it, onto this machine.

    A file that is here with its size is not fetched again, unless ``verify`` finds it damaged. Every other file is
    fetched to ``FILE.part``, resumed where an earlier run stopped, and renamed when its sha256 is the manifest's.
    Blocks that the release shares with an earlier one land in the earlier one's folder, once.

    Parameters
    ----------
    release : str, optional
        Name of a published release; the newest one by default.
    tasks, rounds, split
        Part of it; everything by default.
    sources : sequence of str or path
        Folders of releases, or their URLs, that are asked first, in order: a folder, ``file://``, ``http(s)://``,
        ``hf://datasets/ORG/NAME[@REVISION]``, ``s3://`` or any other protocol of fsspec. After them come the folders
        that belong to this checkout or package, then the mirrors that the manifest names.
    jobs : int, optional
        Files that are fetched at a time; 8 by default.
    offline : bool
        Ask only folders of this machine. ``REMA_OFFLINE=1`` in the environment does the same.
    dry_run : bool
        Report what would be fetched, and touch nothing.
    progress : Progress, optional
    manifest : path, optional
        Manifest of a release that is not published.
    verify : bool
        Rehash the files that are here, and fetch the damaged ones again.

    Returns
    -------
    DownloadReport

    Raises
    ------
    InputError
        There is no such release, task, round or split, or a source cannot be one.
    MissingFileError
        No source has delivered a file. The others are here.
    IntegrityError
        The same, and a source sent other bytes than those of the release.
    RunMismatchError
        Another release of the same name is in the way.
    StorageError
        The disk is full or may not be written. What has arrived stays, and the next run resumes.
    """
    if jobs is not None and jobs < 1:
        raise InputError(f"{jobs} files at a time is not possible", hint="use --jobs 1 or more", jobs=jobs)
    wanted = _manifest(release, manifest)
    folder = ReleaseFolder(wanted, downloads_folder())
    files = wanted.files_of(wanted.select(tasks, rounds, split))
    only_local = offline or _offline_by_environment()
    asked = _sources(sources, wanted, only_local)
    _check_name_is_free(folder)
    plan = make_plan(folder, files, verify)
    sink = Silent() if progress is None else progress
    outcome = Outcome(0, {}, ())
    again = f"rema download {wanted.name}"
    if manifest is not None:
        again += f" --manifest {shlex.quote(os.fspath(manifest))}"
    if not dry_run and plan.missing:
        with _locks(folder.root, {entry.holder for entry in plan.missing}, sink):
            plan = make_plan(folder, files, verify)  # another process may have fetched them meanwhile
            outcome = _fetch(folder, plan, asked, jobs or JOBS, sink)
    _raise_undelivered(outcome, len(plan.files), folder, asked, only_local, again)
    if not dry_run:
        path = folder.path / MANIFEST  # last, so that a folder that can be opened by its path is whole
        if not path.exists():
            write_atomic(path, wanted.to_bytes())
    return DownloadReport(
        name=wanted.name,
        sha256=wanted.sha256,
        root=folder.root,
        files=len(plan.files),
        bytes=plan.bytes,
        present_files=len(plan.files) - len(plan.missing),
        present_bytes=plan.bytes - plan.missing_bytes,
        fetched_files=0 if dry_run else len(plan.missing),
        fetched_bytes=0 if dry_run else plan.missing_bytes,
        moved_bytes=outcome.moved,
        sources=outcome.used,
        asked=tuple(source.label for source in asked),
        blocks=plan.by_block(asked),
        dry_run=dry_run,
    )


def fetch_again(
    folder: ReleaseFolder, locations: Iterable[str], sources: Sequence[str | os.PathLike[str]], again: str
) -> None:
    """Fetch files of a release again: each one stays as it was until the right bytes are here.

    ``again`` is the command that does the same, for the hint of an error. Sources and errors are those of ``download``.
    """
    wanted = set(locations)
    files = tuple(file for file in folder.manifest.files if file.location in wanted)
    only_local = _offline_by_environment()
    asked = [source for source in _sources(sources, folder.manifest, only_local) if not _is_folder(source, folder.root)]
    with _locks(folder.root, {file.holder for file in files}, Silent()):
        outcome = _fetch(folder, Plan(files, files), asked, JOBS, Silent())
    _raise_undelivered(outcome, len(files), folder, asked, only_local, again)


def _is_folder(source: Source, folder: Path) -> bool:
    """Whether a source is this very folder, whose files are damaged."""
    place = source.folder()
    return place is not None and place.resolve() == folder.resolve()


def _manifest(release: str | None, path: str | os.PathLike[str] | None) -> Manifest:
    if path is None:
        name = newest() if release is None else release
        names = published()
        if name not in names:
            raise InputError(
                f"there is no published release {name!r}",
                hint=f"choose one of: {', '.join(names)}; or hand over the manifest of another: --manifest FILE",
                name=name,
            )
        return load_published(name)
    try:
        data = absolute(path).read_bytes()
    except OSError as error:
        raise MissingFileError(
            f"the manifest {os.fspath(path)} cannot be read: {error.strerror}", hint="name the file with --manifest"
        ) from error
    found = parse_manifest(data, os.fspath(path))
    if release not in (None, found.name):
        raise InputError(
            f"{os.fspath(path)} is the manifest of {found.name}, not of {release}", hint=f"ask for {found.name}"
        )
    return found


def _offline_by_environment() -> bool:
    return os.environ.get("REMA_OFFLINE", "").strip().lower() not in ("", "0", "false", "no", "off")


def _sources(named: Sequence[str | os.PathLike[str]], manifest: Manifest, only_local: bool) -> list[Source]:
    """The sources in the order in which they are asked."""
    first = [Source(url) for url in named]
    for source in first:
        source.check()
    own = [Source(folder) for folder in local_sources()]
    found = {source.url: source for source in (*first, *own, *(Source(url) for url in manifest.sources))}
    return [source for source in found.values() if source.local or not only_local]


def _check_name_is_free(folder: ReleaseFolder) -> None:
    path = folder.path / MANIFEST
    try:
        same = path.read_bytes() == folder.manifest.to_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return
    if not same:
        raise RunMismatchError(
            f"{folder.path} holds another release of the name {folder.manifest.name}",
            hint=f"move it away: mv {folder.path} {folder.path}.old, or set REMA_HOME to another folder",
            path=str(folder.path),
        )


@contextmanager
def _locks(root: Path, holders: Iterable[str], progress: Progress) -> Iterator[None]:
    """Keep other processes out of some folders. The order is fixed, so that two never wait for each other."""
    with ExitStack() as stack:
        for holder in sorted(holders):
            path = root / f".{holder}.lock"
            with storage_errors(path):
                root.mkdir(parents=True, exist_ok=True)
                waiting = partial(progress.note, f"another process downloads {holder}: waiting for it")
                stack.enter_context(lock(path, wait=True, waiting=waiting, hint=LOCAL_HOME))
        yield


def _fetch(folder: ReleaseFolder, plan: Plan, sources: Sequence[Source], jobs: int, progress: Progress) -> Outcome:
    if not plan.missing:
        return Outcome(0, {}, ())
    check_space(folder.root, plan)
    _LOG.info("fetching %d files of %s, %d bytes", len(plan.missing), folder.manifest.name, plan.missing_bytes)
    progress.phase("download", plan.missing_bytes)
    try:
        return fetch_files(plan.missing, folder.root, sources, jobs, progress)
    finally:
        _remove_empty(folder.root, {folder.root / entry.location for entry in plan.missing})


def _remove_empty(root: Path, paths: Iterable[Path]) -> None:
    """Remove the folders of files that did not arrive, where nothing is in them."""
    folders = {parent for path in paths for parent in path.parents if parent.is_relative_to(root) and parent != root}
    for path in sorted(folders, key=lambda path: -len(path.parts)):
        with suppress(OSError):  # not empty, or never made
            path.rmdir()


def _raise_undelivered(
    outcome: Outcome, files: int, folder: ReleaseFolder, asked: Sequence[Source], only_local: bool, again: str
) -> None:
    """Raise where no source has delivered a file; ``again`` is the command that asks again."""
    failed = outcome.undelivered
    if not failed:
        return
    by_answers: dict[tuple[tuple[str, str], ...], list[str]] = {}
    for error in sorted(failed, key=lambda error: error.entry.location):
        by_answers.setdefault(tuple(error.answers.items()), []).append(error.entry.location)
    lines = [f"{len(failed)} of {files} files of {folder.manifest.name} could not be fetched"]
    for answers, locations in list(by_answers.items())[:_LISTED]:
        lines.append(locations[0] + (f" and {len(locations) - 1} more" if len(locations) > 1 else ""))
        lines += [f"  {label}: {said}" for label, said in answers] or ["  no source is known"]
    if len(by_answers) > _LISTED:
        lines.append(f"and {len(by_answers) - _LISTED} other reasons")
    hint = f"run the same command again (it resumes), or name another mirror: {again} --source URL"
    if all(source.local for source in asked):  # a folder that lacks a file will not have it in a minute either
        hint = f"name a mirror: {again} --source URL"
    if only_local:
        hint = "only folders of this machine were asked (offline): go online, or name a folder: --source FOLDER"
    kind = IntegrityError if any(error.corrupt for error in failed) else MissingFileError
    raise kind("\n".join(lines), hint=hint, files=[error.entry.location for error in failed])
