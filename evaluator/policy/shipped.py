"""The networks that come with the repository: ``manifests/checkpoints.json`` names them, with the sha256 of every file.

::

    {"policies": {"tae-joint": {"folder": "rema-v0/joint", "files": {"grasp.safetensors": "<sha256>", ...},
                                "tasks": {"grasp_grasp_push": {"folder": "rema-v0-tool2/joint", "files": {...}}}}}}

A folder lies below ``checkpoints`` in a folder of releases: that of the downloads, of the package or of a checkout. A
policy may play some tasks with networks of their own, so that what it is in the other tasks does not change.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rema_data.errors import InputError, IntegrityError, MissingFileError
from rema_data.locks import lock
from rema_data.manifests import manifests_dir, read_manifest
from rema_data.release.folder import downloads_folder, local_sources
from rema_data.schema import TASKS
from rema_data.storage import file_sha256, write_atomic

__all__ = ["CHECKPOINTS", "Shipped", "publish_checkpoint", "shipped_checkpoint", "shipped_policies"]

CHECKPOINTS = "checkpoints"
"""Folder of networks, inside a folder of releases; and, with a suffix, the name of their manifest."""
_LONGEST = 200
"""Characters of a name in the manifest: a longer one is none on some file systems."""


@dataclass(frozen=True, slots=True)
class Shipped:
    """Networks of a policy: their folder below ``checkpoints``, the sha256 of every file, and those of single tasks."""

    folder: str
    files: Mapping[str, str]
    tasks: Mapping[str, Shipped] = field(default_factory=dict)

    def of(self, task: str | None) -> Shipped:
        """The networks that play a task; those of most tasks where it is None."""
        return self if task is None else self.tasks.get(task, self)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, ready for JSON."""
        own = {task: networks.to_dict() for task, networks in sorted(self.tasks.items())}
        return {"folder": self.folder, "files": dict(self.files)} | ({"tasks": own} if own else {})


def shipped_policies() -> dict[str, Shipped]:
    """The networks of each policy in the manifest, or IntegrityError."""
    path = _manifest()
    if not path.is_file():
        return {}
    return read_manifest(
        path,
        "the manifest of networks",
        lambda content: {name: _shipped(one) for name, one in content["policies"].items()},
    )


def _shipped(entry: Any, within: bool = False) -> Shipped:
    """An entry of the manifest; one of a single task has no tasks itself. ValueError and the like for a bad one."""
    folder, files = str(entry["folder"]), dict(entry["files"])
    if longest := [name for name in (folder, *files) if len(name) > _LONGEST]:
        raise ValueError(f"it names {longest[0][:_LONGEST]!r}..., which is too long for a file")
    tasks = {} if within else dict(entry.get("tasks", {}))
    if unknown := sorted(set(tasks) - set(TASKS)):
        raise ValueError(f"it has networks for {unknown[0]!r:.60}, which is not a task")
    return Shipped(folder, files, {task: _shipped(own, within=True) for task, own in tasks.items()})


def shipped_checkpoint(policy: str, task: str | None = None) -> Path | None:
    """Folder of the networks with which a built-in policy plays a task; None for a policy without any.

    Every file of the manifest is checked. Without a task it is the folder that plays most tasks.

    Raises MissingFileError where they are not on this machine, IntegrityError where a file differs in every place.
    """
    entry = shipped_policies().get(policy)
    if entry is None:
        return None
    networks = entry.of(task)
    wrong: list[IntegrityError] = []
    for root in (downloads_folder(), *local_sources()):
        place = root / CHECKPOINTS / networks.folder
        if not all((place / name).is_file() for name in networks.files):
            continue
        try:
            _check(place, networks.files)
        except IntegrityError as error:  # an older download does not hide what a checkout has
            wrong.append(error)
            continue
        return place.resolve()
    if wrong:
        raise wrong[0]
    raise MissingFileError(
        f"the networks of {policy} ({networks.folder}) are not on this machine",
        hint="run it in a clone of the repository, which has them under releases/checkpoints; or name others: "
        "--checkpoint FOLDER",
        policy=policy,
    )


def publish_checkpoint(policy: str, folder: str, place: Path, task: str | None = None) -> None:
    """Enter the networks in ``place`` in the manifest as those of a policy: ``folder`` is below ``checkpoints``.

    With a task they play this one alone, and those of the other tasks stay; without, those of single tasks stay. Raises
    InputError for the networks of a task where the policy has none for the others.
    """
    made = Shipped(folder, {name: file_sha256(place / name) for name in sorted(_networks(place))})
    path = _manifest()
    path.parent.mkdir(parents=True, exist_ok=True)
    with lock(path.with_name(f".{path.name}.lock"), wait=True):  # held for milliseconds: wait for it
        known = shipped_policies()
        before = known.get(policy)
        if task is not None and before is None:
            raise InputError(
                f"{policy} has no networks for other tasks than {task}",
                hint="register the plan that trains these first",
                policy=policy,
            )
        tasks = {} if before is None else before.tasks
        if before is None or task is None:
            entry = Shipped(made.folder, made.files, tasks)
        else:
            entry = Shipped(before.folder, before.files, {**tasks, task: made})
        entries = {name: one.to_dict() for name, one in sorted({**known, policy: entry}.items())}
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
