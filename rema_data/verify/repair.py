"""Fetching again the files of a downloaded release that are damaged, and only those."""

from __future__ import annotations

import os
from collections.abc import Sequence

from rema_data.errors import InputError
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST
from rema_data.release.repair import RepairHints, is_download
from rema_data.storage import write_atomic
from rema_data.verify.findings import Report

__all__ = ["repair"]


def repair(release: ReleaseFolder, report: Report, sources: Sequence[str | os.PathLike[str]] = ()) -> None:
    """Fetch the damaged files of a downloaded release again. Each one stays until its replacement is here.

    Parameters
    ----------
    release : ReleaseFolder
    report : Report
        Of its verification.
    sources : sequence of str or path
        Folders of releases that are asked first, as in ``rema_data.download.download``.

    Raises
    ------
    InputError
        The release has not been downloaded: its files are somebody's originals.
    RemaError
        See ``rema_data.download.fetch.fetch_again``.
    """
    mending = RepairHints(release)
    if not is_download(release):
        raise InputError(
            f"{release.path} was not downloaded, so nothing in it is changed",
            hint=mending.file(report.damaged[0] if report.damaged else report.release),
            path=str(release.path),
        )
    from rema_data.download.fetch import fetch_again

    manifest = f"{release.manifest.name}/{MANIFEST}"
    if manifest in report.damaged:
        write_atomic(release.path / MANIFEST, release.manifest.to_bytes())
    files = [location for location in report.damaged if location != manifest]
    if files:
        fetch_again(release, files, sources, f"{mending.verify} --repair")
