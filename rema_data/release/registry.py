"""The published releases: ``manifests/datasets/index.json`` lists them in order, with the sha256 of each manifest."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

from rema_data.errors import InputError, MissingFileError
from rema_data.locks import lock
from rema_data.manifests import manifests_dir, read_manifest
from rema_data.release.manifest import Manifest, check_name, parse_manifest
from rema_data.repair import restore
from rema_data.storage import write_atomic

__all__ = ["SAMPLE", "load_published", "newest", "preferred", "published", "register"]

SAMPLE = "rema-sample"
"""The release that ships inside the wheel."""


def _folder() -> Path:
    return manifests_dir() / "datasets"


class _Entry(NamedTuple):
    """A published release: sha256 of its manifest, and the published release that it continues, if any."""

    sha256: str
    continues: str | None


def _index() -> dict[str, _Entry]:
    """All entries, by name, in the order of publication."""

    def entries(content: Any) -> dict[str, _Entry]:
        rows = content["releases"]
        return {check_name(row["name"]): _Entry(str(row["sha256"]), row.get("continues")) for row in rows}

    return read_manifest(_folder() / "index.json", "the index of releases", entries)


def published() -> dict[str, str]:
    """sha256 of the manifest of every release, by name, in the order of publication.

    Raises MissingFileError or IntegrityError where the index does not exist or cannot be read.
    """
    return {name: entry.sha256 for name, entry in _index().items()}


def preferred() -> list[str]:
    """Names in the order of the default: the newest release that continues no other first, the bundled sample last.

    A release that continues another one adds a task or other scenes to it: users ask for it by its name.
    """
    index = _index()
    newest_first = [*reversed(index)]
    return sorted(newest_first, key=lambda name: (name == SAMPLE, index[name].continues is not None))


def newest() -> str:
    """Name of the default release, the bundled sample aside."""
    names = [name for name in preferred() if name != SAMPLE]
    if not names:
        raise MissingFileError("no release has been published", hint=f"use the bundled sample: {SAMPLE}")
    return names[0]


def load_published(name: str) -> Manifest:
    """Manifest of a published release, checked against the index.

    Raises InputError for an unknown name, MissingFileError or IntegrityError without the published manifest.
    """
    entries = published()
    if name not in entries:
        raise InputError(f"there is no release {name!r}", hint=f"choose one of: {', '.join(entries)}", name=name)
    path = _folder() / f"{name}.json"
    if not path.is_file():
        raise MissingFileError(f"the manifest {path} does not exist", hint=restore(path), path=str(path))
    return parse_manifest(path.read_bytes(), str(path), entries[name], restore(path))


def register(manifest: Manifest, continues: str | None = None) -> Path:
    """Enter a sealed release at the end of the index; its manifest's path. InputError if the name is taken.

    ``continues`` names the published release whose rounds are its first ones.
    """
    folder = _folder()
    path = folder / f"{manifest.name}.json"
    with lock(folder / ".index.json.lock", wait=True):  # held for milliseconds: wait for it
        entries = _index() if (folder / "index.json").exists() else {}
        known = entries.setdefault(manifest.name, _Entry(manifest.sha256, continues))
        if known.sha256 != manifest.sha256:
            raise InputError(
                f"release {manifest.name} is published with other content ({known.sha256[:12]})",
                hint="publish the new content under a new name",
                name=manifest.name,
            )
        write_atomic(path, manifest.to_bytes())
        rows = [
            {"name": name} | {key: value for key, value in entry._asdict().items() if value is not None}
            for name, entry in entries.items()
        ]
        write_atomic(folder / "index.json", json.dumps({"releases": rows}, indent=1) + "\n")
    return path
