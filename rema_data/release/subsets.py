"""Fixed subsets of the training episodes of a published release, such as ``10pct-r1``.

The training episodes of every block are dealt into a hundred parts by their names. Replicate K of 10 % is the ten parts
from 10 (K - 1) on, and that of 1 % the first of these: a fraction holds the smaller one of its replicate, and two
replicates share no episode. ``manifests/subsets/RELEASE.json`` says, for every subset and block, which rows that gave
when the release was published.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, NonNegativeInt

from rema_data.errors import InputError, IntegrityError
from rema_data.json_files import checked_digest, read_json, with_digest
from rema_data.manifests import manifests_dir
from rema_data.release.manifest import BlockEntry, Manifest
from rema_data.repair import restore
from rema_data.storage import write_atomic
from rema_data.validation import plain, record, validated

__all__ = [
    "FRACTIONS",
    "REPLICATES",
    "SubsetRows",
    "Subsets",
    "freeze",
    "in_subset",
    "large_enough",
    "names",
    "rows_of",
    "subsets_of",
]

FRACTIONS = {"1pct": 1, "10pct": 10}
"""Percent of the episodes, by the first half of a subset's name."""
REPLICATES = 10
_PARTS = 100
_HASHED = np.dtype([("episode", "<i4"), ("step", "i1"), ("action", "<u2"), ("success", "?")])
"""The bytes of a step in the sha256 of the rows of a subset."""
Mask = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.void]
"""Structured array with the fields of ``_HASHED`` among others, one row an executed step."""


@record
class SubsetRows:
    """The executed steps of a subset in one block."""

    episodes: NonNegativeInt
    steps: NonNegativeInt
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]  # of (episode, step, action, success) of every step


@record
class Subsets:
    """The manifest of the subsets of a release."""

    format: Literal[1]
    release: str
    manifest: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]  # sha256 of the release's manifest
    subsets: Mapping[str, Mapping[str, SubsetRows]]  # by name of the subset and path of the block


def _path(release: str) -> Path:
    return manifests_dir() / "subsets" / f"{release}.json"


def names() -> tuple[str, ...]:
    """The subsets that a release of at least a hundred training episodes a block has."""
    return tuple(f"{fraction}-r{number}" for fraction in FRACTIONS for number in range(1, REPLICATES + 1))


def large_enough(manifest: Manifest) -> bool:
    """Whether every training block has an episode for each part."""
    return all(block.episodes >= _PARTS for block in manifest.blocks if block.split == "train")


def in_subset(name: str, block: BlockEntry) -> Mask:
    """Whether an episode of a training block is in a subset, bool (episodes,); InputError for an unknown name."""
    fraction, _, replicate = name.partition("-r")
    if name not in names():
        raise InputError(f"there is no subset {name!r}", hint=f"choose one of: {', '.join(names())}", subset=name)
    first = (int(replicate) - 1) * (_PARTS // REPLICATES)
    parts = _parts(block)
    return (parts >= first) & (parts < first + FRACTIONS[fraction])


def _parts(block: BlockEntry) -> npt.NDArray[np.int64]:
    """The part of every episode: their order is that of the hashes of their names."""
    keys = [
        hashlib.blake2b(f"{block.key.path}/{episode}".encode(), digest_size=16).digest()
        for episode in range(block.episodes)
    ]
    order = sorted(range(block.episodes), key=keys.__getitem__)
    parts = np.empty(block.episodes, np.int64)
    parts[order] = np.arange(block.episodes) * _PARTS // max(1, block.episodes)
    return parts


def rows_of(steps: Rows, chosen: Mask) -> tuple[Mask, SubsetRows]:
    """Which executed steps of a block are of some of its episodes, and what they are."""
    inside: Mask = chosen[steps["episode"]]
    hashed = np.zeros(int(inside.sum()), _HASHED)
    for field in _HASHED.names or ():
        hashed[field] = steps[field][inside]
    return inside, SubsetRows(int(chosen.sum()), len(hashed), hashlib.sha256(hashed.tobytes()).hexdigest())


def subsets_of(manifest: Manifest) -> Subsets:
    """The subsets of a release.

    Raises
    ------
    InputError
        It has none, or those of its name are of a release with other content.
    IntegrityError
        Their manifest is damaged.
    """
    path = _path(manifest.name)
    try:
        content = checked_digest(read_json(path))
        found = validated(Subsets, content, str(path), hint=restore(path), error=IntegrityError)
    except FileNotFoundError:
        has = ", ".join(sorted(file.stem for file in path.parent.glob("*.json")))
        raise InputError(
            f"release {manifest.name} has no fixed subsets",
            hint=f"choose a release that has: {has}; or select steps yourself, with dataset.select(mask)",
            release=manifest.name,
        ) from None
    except (ValueError, OSError) as error:
        raise IntegrityError(f"{path} cannot be read: {error}", hint=restore(path), path=str(path)) from error
    if (found.release, found.manifest) != (manifest.name, manifest.sha256):
        raise InputError(
            f"the subsets of {manifest.name} are those of a release with other content: {found.manifest[:12]}, this "
            f"one has the manifest {manifest.sha256[:12]}",
            hint="use the published release: rema download " + manifest.name,
            expected=found.manifest,
            got=manifest.sha256,
        )
    return found


def freeze(manifest: Manifest, steps_of: Mapping[str, Rows]) -> Path:
    """Write the manifest of the subsets of a published release; ``steps_of`` has the steps of every training block.

    Raises InputError where they are published with other rows.
    """
    blocks = [block for block in manifest.blocks if block.split == "train"]
    found = {
        name: {block.key.path: rows_of(steps_of[block.key.path], in_subset(name, block))[1] for block in blocks}
        for name in names()
    }
    subsets, path = Subsets(1, manifest.name, manifest.sha256, found), _path(manifest.name)
    if path.exists() and subsets_of(manifest) != subsets:
        raise InputError(
            f"the subsets of {manifest.name} are published with other rows",
            hint="publish the new content under a new name",
        )
    path.parent.mkdir(exist_ok=True)
    write_atomic(path, json.dumps(with_digest(plain(subsets)), indent=1) + "\n")
    return path
