"""The bytes of a release: its manifest and every file that it names, checked and fetched again."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from pathlib import Path

from rema_data import interrupts
from rema_data.download.fetch import fetch_again
from rema_data.download.part import SUFFIX
from rema_data.errors import InputError
from rema_data.progress import Progress
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST, BlockEntry, FileEntry
from rema_data.release.registry import published
from rema_data.repair import delete
from rema_data.schema import TASKS
from rema_data.storage import file_sha256, write_atomic
from rema_data.verify.findings import Findings, Report

__all__ = ["absent_blocks", "check_files", "check_manifest", "check_unexpected", "repair"]


def check_manifest(release: ReleaseFolder, findings: Findings) -> set[str]:
    """Compare the manifest with the index of published releases, and the copy beside the data with it.

    Returns the location of the copy where it is damaged.
    """
    manifest, copy = release.manifest, release.path / MANIFEST
    location = f"{manifest.name}/{MANIFEST}"
    known = published().get(manifest.name)
    if known is not None and known != manifest.sha256:
        findings.add(
            "manifest",
            str(copy),
            f"it is not the published {manifest.name}: its sha256 is {manifest.sha256}, the index has {known}",
            fix=f"rename this release, or use the published one: rema download {manifest.name}",
        )
    for block in manifest.blocks:
        if len(block.policies) != len(TASKS[block.task]):
            findings.add(
                "manifest",
                str(copy),
                f"block {block.key.path} has {len(block.policies)} policies for {len(TASKS[block.task])} steps",
                fix="seal the release again from its plan: rema collect PLAN",
            )
    if not copy.is_file():
        findings.add("missing", str(copy), "the manifest beside the data", fix=release.repair.file(location))
    elif copy.read_bytes() != manifest.to_bytes():
        findings.add("manifest", str(copy), "it is not the release's manifest", fix=release.repair.file(location))
    else:
        return set()
    return {location}


def absent_blocks(release: ReleaseFolder, blocks: Sequence[BlockEntry]) -> tuple[BlockEntry, ...]:
    """Blocks of a downloaded release of which no file is here: they have never been fetched."""
    if not release.downloaded:
        return ()
    here = {file.block for file in release.manifest.files if release.file(file).exists()}
    return tuple(block for block in blocks if block.key.path not in here)


def check_files(
    release: ReleaseFolder, entries: Sequence[FileEntry], findings: Findings, progress: Progress
) -> set[str]:
    """Check presence, size and sha256 of files; the locations of those that are damaged."""
    damaged, fixes = set(), release.repair
    progress.phase("files", len(entries))
    for entry in entries:
        interrupts.check()
        path = release.file(entry)
        fault = _fault(path, entry)
        if fault is not None:
            damaged.add(entry.location)
            findings.add(*fault, fix=fixes.file(entry.location))
        progress.advance(1)
    return damaged


def _fault(path: Path, entry: FileEntry) -> tuple[str, str, str] | None:
    """Kind, file and detail of what is wrong with a file."""
    if not path.is_file():
        return "missing", str(path), f"{entry.bytes:,} bytes"
    size = path.stat().st_size
    if size != entry.bytes:
        return "size", str(path), f"it has {size:,} bytes, the manifest says {entry.bytes:,}"
    got = file_sha256(path)
    if got != entry.sha256:
        return "sha256", str(path), f"its sha256 is {got[:16]}..., the manifest says {entry.sha256[:16]}..."
    return None


def check_unexpected(release: ReleaseFolder, findings: Findings) -> None:
    """Look for files in the release's own folder that the manifest does not name."""
    name = release.manifest.name
    listed: Collection[Path] = {release.file(file) for file in release.manifest.files if file.holder == name}
    for path in sorted(release.path.rglob("*")):
        if path.is_dir() or path in listed or path == release.path / MANIFEST:
            continue
        if not (release.downloaded and path.suffix == SUFFIX):
            findings.add("unexpected", str(path), "the manifest does not name it", fix=delete(path))


def repair(release: ReleaseFolder, report: Report, sources: Sequence[str | os.PathLike[str]] = ()) -> None:
    """Fetch the damaged files of a downloaded release again, with ``sources`` asked first, as in ``download``.

    Raises
    ------
    InputError
        The release was not downloaded: nothing in it is changed.
    RemaError
        As ``download`` does.
    """
    if not release.downloaded:
        raise InputError(
            f"{release.path} was not downloaded, so nothing in it is changed",
            hint=release.repair.file(report.damaged[0] if report.damaged else report.release),
            path=str(release.path),
        )
    manifest = f"{release.manifest.name}/{MANIFEST}"
    if manifest in report.damaged:
        write_atomic(release.path / MANIFEST, release.manifest.to_bytes())
    files = [location for location in report.damaged if location != manifest]
    if files:
        fetch_again(release, files, sources, f"{release.repair.verify} --repair")
