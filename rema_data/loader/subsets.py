"""Which steps of a decoded release are in one of its fixed subsets."""

from __future__ import annotations

from collections.abc import Container, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from rema_data.errors import IntegrityError
from rema_data.release.entries import BlockEntry
from rema_data.release.subsets import freeze, in_subset, rows_of, subsets_of
from rema_data.store.keys import BlockKey

if TYPE_CHECKING:
    from rema_data.loader.release import Release

__all__ = ["freeze_subsets", "steps_in_subset"]


def steps_in_subset(release: Release, name: str, wanted: Container[BlockKey]) -> npt.NDArray[np.bool_]:
    """False for every local step of ``wanted`` training blocks that is not in a subset, bool (steps,).

    Raises InputError for an unknown subset, or a release that has none, and IntegrityError where the steps are not
    those of the manifest of the subsets.
    """
    known = subsets_of(release.manifest).subsets
    keep = np.ones(len(release.cache.index), bool)
    for block, rows in _training_blocks(release):
        if block.key not in wanted:
            continue
        keep[rows], found = rows_of(release.cache.index[rows], in_subset(name, block))
        if found != known[name][block.key.path]:
            raise IntegrityError(
                f"the steps of the subset {name} in {block.key.path} are not those of its manifest",
                hint=f"compare the release with its checksums: rema verify {release.name}",
                block=block.key.path,
            )
    return keep


def freeze_subsets(release: Release) -> Path:
    """Write the manifest of the subsets of a published release, all of which is on this machine."""
    release.folder.require(release.manifest.blocks)
    return freeze(
        release.manifest,
        {block.key.path: release.cache.index[rows] for block, rows in _training_blocks(release)},
    )


def _training_blocks(release: Release) -> Iterator[tuple[BlockEntry, slice]]:
    """Training blocks on this machine, and where their steps are in the index."""
    first = 0
    for block in release.blocks:
        rows = slice(first, first := first + block.steps)
        if block.split == "train":
            yield block, rows
