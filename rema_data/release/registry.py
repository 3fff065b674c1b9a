"""The published releases: ``manifests/datasets/index.json`` lists them in order, with the sha256 of each manifest."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rema_data.errors import InputError, MissingFileError
from rema_data.manifests import manifests_dir, read_manifest
from rema_data.release.manifest import Manifest, check_name, parse_manifest
from rema_data.repair import restore
from rema_data.storage import write_atomic

__all__ = ["SAMPLE", "Published", "load_published", "newest", "published", "register"]

SAMPLE = "rema-sample"
"""The release that ships inside the wheel."""


@dataclass(frozen=True, slots=True)
class Published:
    """An entry of the index: a release and its identity."""

    name: str
    sha256: str


def _folder() -> Path:
    return manifests_dir() / "datasets"


def published() -> tuple[Published, ...]:
    """Releases in the order of their publication.

    Raises
    ------
    MissingFileError, IntegrityError
        The index is not there, or cannot be read.
    """

    def releases(content: Any) -> tuple[Published, ...]:
        return tuple(Published(check_name(row["name"]), str(row["sha256"])) for row in content["releases"])

    return read_manifest(_folder() / "index.json", "the index of releases", releases)


def newest() -> str:
    """Name of the release published last, the bundled sample aside."""
    names = [entry.name for entry in published() if entry.name != SAMPLE]
    if not names:
        raise MissingFileError("no release has been published", hint=f"use the bundled sample: {SAMPLE}")
    return names[-1]


def load_published(name: str) -> Manifest:
    """Manifest of a published release, checked against the index.

    Raises
    ------
    InputError
        There is no release of that name.
    MissingFileError, IntegrityError
        Its manifest is not there, or is not the published one.
    """
    entries = {entry.name: entry for entry in published()}
    if name not in entries:
        raise InputError(f"there is no release {name!r}", hint=f"choose one of: {', '.join(entries)}", name=name)
    path = _folder() / f"{name}.json"
    if not path.is_file():
        raise MissingFileError(f"the manifest {path} does not exist", hint=restore(path), path=str(path))
    return parse_manifest(path.read_bytes(), str(path), entries[name].sha256, restore(path))


def register(manifest: Manifest) -> Path:
    """Enter a sealed release at the end of the index; its manifest's path.

    Raises
    ------
    InputError
        A release of that name with other content is published already: it can never change.
    """
    from filelock import FileLock  # only who publishes needs it

    with FileLock(_folder() / ".index.json.lock"):  # held for milliseconds: wait for it
        return _register(manifest)


def _register(manifest: Manifest) -> Path:
    folder = _folder()
    entries = published() if (folder / "index.json").exists() else ()
    path = folder / f"{manifest.name}.json"
    for entry in entries:
        if entry.name == manifest.name and entry.sha256 != manifest.sha256:
            raise InputError(
                f"release {manifest.name} is published with other content ({entry.sha256[:12]})",
                hint="publish the new content under a new name",
                name=manifest.name,
            )
    write_atomic(path, manifest.to_bytes())
    if manifest.name not in {entry.name for entry in entries}:
        rows = [{"name": entry.name, "sha256": entry.sha256} for entry in entries]
        rows.append({"name": manifest.name, "sha256": manifest.sha256})
        write_atomic(folder / "index.json", json.dumps({"releases": rows}, indent=1) + "\n")
    return path
