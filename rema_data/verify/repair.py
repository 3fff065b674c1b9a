"""Fetching again the files of a downloaded release that are damaged, and only those."""

from __future__ import annotations

from rema_data.errors import InputError
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST, BlockEntry
from rema_data.release.registry import published
from rema_data.storage import storage_errors
from rema_data.verify.files import is_download, refetch
from rema_data.verify.findings import Report

__all__ = ["remove_damaged", "repair"]


def remove_damaged(release: ReleaseFolder, report: Report) -> tuple[BlockEntry, ...]:
    """Delete the damaged files of a downloaded release.

    Returns
    -------
    tuple of BlockEntry
        Blocks with which ``rema download`` fetches them again: those that lost a file, or any one where only files of
        the whole release did.

    Raises
    ------
    InputError
        The release has not been downloaded: its files are somebody's originals.
    StorageError
        A file may not be deleted.
    """
    if not is_download(release):
        raise InputError(
            f"{release.path} was not downloaded, so nothing in it is deleted",
            hint=refetch(release, report.damaged[0] if report.damaged else report.release),
            path=str(release.path),
        )
    for location in report.damaged:
        path = release.root / location
        with storage_errors(path):
            path.unlink(missing_ok=True)
    lost = {file.block for file in release.manifest.files if file.location in report.damaged}
    blocks = tuple(block for block in release.manifest.blocks if block.key.path in lost)
    fetched = [block for block in release.manifest.blocks if block.key.path not in report.absent]
    return blocks or tuple(fetched[:1])


def repair(release: ReleaseFolder, report: Report) -> None:
    """Delete the damaged files of a downloaded release and fetch them again.

    Parameters
    ----------
    release : ReleaseFolder
    report : Report
        Of its verification.

    Raises
    ------
    InputError, StorageError
        See ``remove_damaged``.
    RemaError
        See ``rema_data.download.download``.
    """
    from rema_data.download import download

    name = release.manifest.name
    manifest = None if name in {entry.name for entry in published()} else release.path / MANIFEST
    for block in remove_damaged(release, report):
        download(name, tasks=[block.task], rounds=[block.round], split=block.split, manifest=manifest)
