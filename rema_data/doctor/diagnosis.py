"""The diagnosis: the state of this machine, its problems and advice."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from rema_data.doctor.disposable import PARTIAL, READY, Disposable, disposables
from rema_data.doctor.machine import Home, PackageVersion, Speed, home, measure_speed, package_versions
from rema_data.doctor.releases import ReleaseState, local_releases
from rema_data.errors import RemaError
from rema_data.loader.decode import map_rows, row_bytes
from rema_data.loader.record import has_digests
from rema_data.loader.release import Release
from rema_data.progress import Progress, Silent
from rema_data.release.folder import ReleaseFolder
from rema_data.release.registry import load_published, preferred, published
from rema_data.repair import install, reinstall

__all__ = ["NEEDED_PER_S", "Diagnosis", "diagnose"]

NEEDED_PER_S = 2_400.0
"""Samples a second that training asks for: batches of 8, as in the paper, 300 times a second."""


@dataclass(frozen=True)
class Diagnosis:
    """The state of this machine."""

    versions: Sequence[PackageVersion]
    home: Home
    releases: Sequence[ReleaseState]
    disposable: Sequence[Disposable]  # decoded caches and partial downloads
    tested: str  # release that was read; empty where none was
    speeds: Sequence[Speed]
    problems: Sequence[str]  # what is wrong, each with its fix
    advice: Sequence[str]  # what would be better

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        content = asdict(replace(self, releases=[replace(state, folder=None) for state in self.releases]))
        for release in content["releases"]:
            del release["folder"]
        return {"ok": not self.problems} | content


def diagnose(read_seconds: float = 1.0, progress: Progress | None = None, contents: bool = False) -> Diagnosis:
    """Look at this machine.

    Parameters
    ----------
    read_seconds : float
        Length of each of the four reading tests; 0 leaves them out. The first builds the decoded cache, as training
        would.
    progress : rema_data.progress.Progress, optional
        Gets a line before each thing that takes time, and the number of decoded bytes.
    contents : bool
        Compare every byte of the decoded caches with what was written.
    """
    progress = progress or Silent()
    state, releases = home(), local_releases()
    problems = list(_problems(package_versions(), state, releases))
    if contents:
        progress.note("checking the content of the decoded caches")
    found = disposables(releases, contents)
    wrong = list(_damaged_caches(found))
    problems += wrong
    chosen, speeds = _newest(releases), list[Speed]()
    if chosen is not None and read_seconds > 0 and not wrong:
        progress.note(f"reading {chosen.manifest.name} (decoded first, where it has not been)")
        try:
            speeds = list(measure_speed(Release(chosen, progress=progress), read_seconds))
        except RemaError as error:
            problems.append(f"{chosen.manifest.name} cannot be read: {error}")
        found = disposables(releases)  # with the cache that may have been built
    return Diagnosis(
        package_versions(),
        state,
        releases,
        found,
        chosen.manifest.name if chosen is not None and speeds else "",
        speeds,
        problems,
        [*_advice(state, releases, found, speeds), *(_unknown_caches(found) if contents else ())],
    )


def _newest(releases: Sequence[ReleaseState]) -> ReleaseFolder | None:
    """The release to read: the first of ``preferred``, else any other."""
    here = [state for state in releases if state.ok and state.blocks and state.folder is not None]
    published = [state for state in here if state.identity == "published"]
    if not published:
        return here[-1].folder if here else None
    order = preferred()
    return min(published, key=lambda state: (order.index(state.name), -state.blocks)).folder


def _problems(versions: Sequence[PackageVersion], state: Home, releases: Sequence[ReleaseState]) -> Iterator[str]:
    for item in versions:
        if item.version is None:
            yield f"{item.name} is not installed: {_package_fix(item)}"
        elif not item.ok:
            yield f"{item.name} {item.version} is outside of {item.wanted}: {_package_fix(item)}"
    if not state.writable:
        yield f"{state.path} cannot be written: set REMA_HOME to another folder"
    for release in releases:
        if not release.ok:
            yield f"{release.path}: {release.identity}; find out more: rema verify {release.path}"


def _package_fix(item: PackageVersion) -> str:
    if item.name == "python":
        return f"install rema into a Python {item.wanted}"
    return reinstall() if item.name == "rema" else install(f"{item.name}{item.wanted}")


def _damaged_caches(found: Sequence[Disposable]) -> Iterator[str]:
    for item in found:
        if item.damaged:
            yield (
                f"the decoded cache {item.path} is damaged ({', '.join(item.damaged)}): "
                "rema doctor --check-caches --prune deletes it, and opening the release builds it again"
            )


def _unknown_caches(found: Sequence[Disposable]) -> Iterator[str]:
    for item in found:
        if item.state == READY and not has_digests(Path(item.path)):
            yield (
                f"the content of the decoded cache {item.path} cannot be checked: an earlier rema made it; it is built "
                f"again, with checksums, after: rm -r '{item.path}'"
            )


def _advice(
    state: Home, releases: Sequence[ReleaseState], found: Sequence[Disposable], speeds: Sequence[Speed]
) -> Iterator[str]:
    if not any(release.blocks for release in releases):
        yield "no release is on this machine: rema download"
    ready = {item.release for item in found if item.state == READY}
    for release in releases:
        size = 0 if release.folder is None or release.name in ready else _decoded_bytes(release)
        if size > state.free_bytes:
            yield (
                f"the decoded cache of {release.name} needs {size / 1e9:.1f} GB, {state.free_bytes / 1e9:.1f} GB are "
                f"free at {state.path}: set REMA_HOME to a larger disk, or use rema_data.load(..., cache='memory')"
            )
    for name in sorted({_published_with(item.release) for item in found if item.state == PARTIAL}):
        yield f"a download of {name} is not finished: rema download {name}"
    wasted = sum(item.bytes for item in found if item.state not in (READY, PARTIAL))
    if wasted:
        yield f"{wasted / 1e6:.0f} MB of decoded caches are of no use any more: rema doctor --prune"
    slow = {speed.delivery for speed in speeds if speed.samples_per_s < NEEDED_PER_S}
    if "quantised" in slow:
        yield (
            f"fewer than {NEEDED_PER_S:,.0f} samples a second are read: the decoded cache is on a slow disk or larger "
            "than the memory; set REMA_HOME to a local disk, or read with num_workers"
        )
    elif slow:
        yield (
            f"float32 batches come slower than {NEEDED_PER_S:,.0f} samples a second: take quantised ones and convert "
            "them on the device with batch.to(device).float()"
        )


def _published_with(holder: str) -> str:
    """The published release that has files in a folder of releases: ``rema download`` knows no other name."""
    names = published()
    for name in () if holder in names else names:
        with suppress(RemaError):
            if any(file.holder == holder for file in load_published(name).files):
                return name
    return holder


def _decoded_bytes(release: ReleaseState) -> int:
    assert release.folder is not None
    return sum(rows * row_bytes(name) for name, rows in map_rows(release.folder.blocks()).items())
