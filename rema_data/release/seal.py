"""Sealing: a folder of blocks becomes a release, which never changes.

The manifest is written last, then the folder gets its name: a release that can be found is whole. Its files are made
read-only; a later change is a new release.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import pyarrow.compute as pc

from rema_data import interrupts
from rema_data.errors import InputError, RunMismatchError
from rema_data.release.card import write_card
from rema_data.release.entries import BlockEntry, FileEntry, Parent, block_order, check_name
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST, Manifest, parse_manifest
from rema_data.schema import TASKS
from rema_data.storage import file_sha256, storage_errors, sync_file, sync_folder, write_atomic
from rema_data.store.block import BlockKey, BlockReader

__all__ = ["Description", "describe_block", "seal"]


@dataclass(frozen=True, slots=True)
class Description:
    """What a release says of itself."""

    name: str
    title: str
    description: str
    license: str
    citation: str
    sources: tuple[str, ...] = ()  # URLs of folders of releases
    published: str = ""  # day of publication as YYYY-MM-DD, or empty


def describe_block(folder: Path, key: BlockKey, holder: str) -> BlockEntry:
    """The manifest's entry of a block in ``folder``, read from its tables."""
    reader = BlockReader(folder)
    episodes, steps = reader.episodes(), reader.steps()
    policies = []
    for step in range(len(TASKS[key.task])):
        names = pc.unique(steps.filter(pc.equal(steps["step"], step))["policy"]).to_pylist()
        policies.append("+".join(sorted(names)))
    return BlockEntry(
        *key,
        episodes=episodes.num_rows,
        steps=steps.num_rows,
        end_effectors=reader.maps().rows("ee_depth"),
        positives=pc.sum(episodes["success"]).as_py() or 0,
        policies=tuple(policies),
        holder=holder,
    )


def seal(
    staging: Path,
    root: Path,
    about: Description,
    keys: Sequence[BlockKey],
    *,
    fingerprint: dict[str, str],
    plan_sha256: str = "",
    parent: Manifest | None = None,
    reused: Sequence[BlockKey] = (),
) -> ReleaseFolder:
    """Turn a folder of blocks into the release ``root / about.name``.

    ``staging`` holds the new blocks, ``keys``; it lies on the file system of ``root``, the folder of releases, and is
    renamed. ``reused`` are blocks of ``parent``, the release that this one continues, that belong to this release too;
    they stay where they are. ``fingerprint`` is the simulator's. Raises InputError for a name that cannot be one or a
    block both new and reused, RunMismatchError where a release of that name is there already, and StorageError.
    """
    target = root / check_name(about.name)
    if target.exists():
        raise RunMismatchError(
            f"{target} exists: a sealed release is never written to",
            hint="collect under another name, or move the old release away",
            path=str(target),
        )
    old = {} if parent is None else {block.key: block for block in parent.blocks}
    twice = [key for key, times in Counter((*keys, *reused)).items() if times > 1]
    if twice or any(key not in old for key in reused):
        raise InputError("a block is listed twice, or is not in the parent release", hint="fix the plan's rounds")
    blocks = [old[key] for key in reused] + [describe_block(staging / key.path, key, about.name) for key in keys]
    blocks.sort(key=block_order)
    kept = {block.key.path for block in blocks if block.key in set(reused)}
    shared = [] if parent is None else [file for file in parent.files if file.block in kept]
    own = [BlockReader(staging / key.path).version() for key in keys]
    continued = [parent.schema_version] if parent is not None and reused else []
    draft = Manifest(
        **{item.name: getattr(about, item.name) for item in fields(about)},
        blocks=tuple(blocks),
        files=_files(staging, about.name, shared),
        fingerprint=fingerprint,
        plan_sha256=plan_sha256,
        parent=None if parent is None else Parent(parent.name, parent.sha256),
        schema_version=max([*own, *continued], default=1),
    )
    write_card(staging, draft, min(own, default=None))
    manifest = replace(draft, files=_files(staging, about.name, shared))
    data = manifest.to_bytes()
    parse_manifest(data, str(target / MANIFEST))
    write_atomic(staging / MANIFEST, data)
    with storage_errors(target):
        _settle(staging)
        root.mkdir(parents=True, exist_ok=True)
        os.rename(staging, target)
        sync_folder(root)
    return ReleaseFolder(manifest, root)


def _files(staging: Path, holder: str, shared: Sequence[FileEntry]) -> tuple[FileEntry, ...]:
    """Entries of the files in ``staging`` and of the shared ones, in the manifest's order."""
    paths = [path for path in staging.rglob("*") if path.is_file() and path != staging / MANIFEST]
    own = []
    for path in paths:
        interrupts.check()
        own.append(FileEntry(path.relative_to(staging).as_posix(), path.stat().st_size, file_sha256(path), holder))
    return tuple(sorted((*own, *shared), key=lambda entry: entry.location))


def _settle(folder: Path) -> None:
    """Make every byte and name below ``folder`` durable, and its files read-only."""
    for path in sorted(folder.rglob("*")):
        if path.is_dir():
            sync_folder(path)
        else:
            sync_file(path)
            path.chmod(0o444)
    sync_folder(folder)
