"""The networks that come with the repository: ``manifests/checkpoints.json`` names them, with the sha256 of every file.

::

    {"policies": {"tae-joint": {"folder": "rema-v0/joint", "files": {"grasp.safetensors": "<sha256>", ...}}}}

A folder lies below ``checkpoints`` in a folder of releases: that of the downloads, of the package or of a checkout.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rema_data.errors import IntegrityError, MissingFileError
from rema_data.locks import lock
from rema_data.manifests import manifests_dir, read_manifest
from rema_data.release.folder import downloads_folder, local_sources
from rema_data.storage import write_atomic

__all__ = ["CHECKPOINTS", "file_sha256", "publish_checkpoint", "shipped_checkpoint", "shipped_policies"]

CHECKPOINTS = "checkpoints"
"""Folder of networks, inside a folder of releases; and, with a suffix, the name of their manifest."""
_LONGEST = 200
"""Characters of a name in the manifest: a longer one is none on some file systems."""


def shipped_policies() -> dict[str, tuple[str, dict[str, str]]]:
    """Folder, and sha256 of every file in it, of each policy in the manifest, or IntegrityError."""
    path = _manifest()
    if not path.is_file():
        return {}

    def entries(content: Any) -> dict[str, tuple[str, dict[str, str]]]:
        found = {name: (str(one["folder"]), dict(one["files"])) for name, one in content["policies"].items()}
        if longest := [name for folder, files in found.values() for name in (folder, *files) if len(name) > _LONGEST]:
            raise ValueError(f"it names {longest[0][:_LONGEST]!r}..., which is too long for a file")
        return found

    return read_manifest(path, "the manifest of networks", entries)


def shipped_checkpoint(policy: str) -> Path | None:
    """Folder of the networks of a built-in policy, every file of the manifest checked; None for a policy without any.

    Raises MissingFileError where they are not on this machine, IntegrityError where a file differs in every place.
    """
    entry = shipped_policies().get(policy)
    if entry is None:
        return None
    folder, files = entry
    wrong: list[IntegrityError] = []
    for root in (downloads_folder(), *local_sources()):
        place = root / CHECKPOINTS / folder
        if not all((place / name).is_file() for name in files):
            continue
        try:
            _check(place, files)
        except IntegrityError as error:  # an older download does not hide what a checkout has
            wrong.append(error)
            continue
        return place.resolve()
    if wrong:
        raise wrong[0]
    raise MissingFileError(
        f"the networks of {policy} ({folder}) are not on this machine",
        hint="run it in a clone of the repository, which has them under releases/checkpoints; or name others: "
        "--checkpoint FOLDER",
        policy=policy,
    )


def publish_checkpoint(policy: str, folder: str, place: Path) -> None:
    """Enter the networks in ``place`` in the manifest as those of a policy: ``folder`` is below ``checkpoints``."""
    files = {name: file_sha256(place / name) for name in sorted(_networks(place))}
    path = _manifest()
    path.parent.mkdir(parents=True, exist_ok=True)
    with lock(path.with_name(f".{path.name}.lock"), wait=True):  # held for milliseconds: wait for it
        known = sorted((shipped_policies() | {policy: (folder, files)}).items())
        entries = {name: {"folder": where, "files": digests} for name, (where, digests) in known}
        write_atomic(path, json.dumps({"policies": entries}, indent=1) + "\n")


def _manifest() -> Path:
    return manifests_dir() / f"{CHECKPOINTS}.json"


def _check(place: Path, files: Mapping[str, str]) -> None:
    """Raise where a folder is not what the manifest names: a policy loads every network that lies in it."""
    for name in sorted(_networks(place) - set(files)):
        raise IntegrityError(
            f"{place / name} is not one of the published networks of {place.name}",
            hint=f"move it elsewhere, and name its folder with --checkpoint; or delete it: {place / name}",
            path=str(place / name),
        )
    for name, expected in files.items():
        found = file_sha256(place / name)
        if found != expected:
            raise IntegrityError(
                f"{place / name} is not the published one: its sha256 is {found[:12]}..., not {expected[:12]}...",
                hint=f"restore it (in a clone: git checkout -- releases/checkpoints), or delete {place}",
                path=str(place / name),
                expected=expected,
                found=found,
            )


def _networks(place: Path) -> set[str]:
    """Names of the files of a folder that are weights or cards."""
    return {path.name for path in place.iterdir() if path.suffix in (".safetensors", ".json")}


def file_sha256(path: Path) -> str:
    """sha256 of a file, hexadecimal; ``rema_data.release.seal`` has it too, but imports much that a policy need not."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
