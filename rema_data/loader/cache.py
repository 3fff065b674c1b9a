"""The decoded cache: plain arrays on disk, built once by one process and mapped by all that read.

::

    <folder>/<manifest sha256, 16 digits>-<hash of the local blocks, 8 digits>/
        scene.npy  ee_depth.npy  ee_mask.npy     one row a scene, one a different end-effector map
        index.npy                                one row a step
        cache.json                               written last: see ``rema_data.loader.record``
        values-<fingerprint>.json                later: see ``rema_data.statistics.values``

The folder is disposable: ``rema_data.load`` builds it again (``rema_data.loader.build``).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rema_data.errors import MissingFileError
from rema_data.loader.decode import MAP_ARRAYS
from rema_data.loader.index import Categories, Index
from rema_data.loader.record import CACHE_VERSION, read_record
from rema_data.storage import rema_home

if TYPE_CHECKING:
    from rema_data.release.folder import ReleaseFolder
    from rema_data.release.manifest import BlockEntry

__all__ = ["DecodedCache", "MapArrays", "MemoryCache", "cache_name", "caches_folder"]

Array = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class MapArrays:
    """The decoded maps."""

    scene: Array  # int16 (steps, 64, 64): height above the table, 0.1 mm
    ee_depth: Array  # int16 (maps, 2, 112, 112): height above the end effector's lowest allowed point, 0.1 mm
    ee_mask: Array  # uint8 (maps, 2, 112, 14): packed, see ``rema_data.heights.unpack_mask``


class DecodedCache:
    """A decoded release: on disk when it has a ``folder``, else in this process's memory.

    Only the folder's path is pickled: every process maps the files for itself, when it first reads.
    """

    def __init__(self, folder: Path) -> None:
        self.folder: Path | None = folder

    @cached_property
    def maps(self) -> MapArrays:
        """The maps, mapped into memory, read-only."""
        return MapArrays(**{name: self._map(name) for name in MAP_ARRAYS})

    @cached_property
    def index(self) -> Index:
        """One row a local step, in the order of the release's blocks; structured array of ``INDEX_DTYPE``."""
        return self._map("index")

    @cached_property
    def categories(self) -> Categories:
        """Values of the index's text columns."""
        assert self.folder is not None
        try:
            found: Categories = read_record(self.folder)["categories"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise self._damage() from error
        return found

    def _map(self, name: str) -> Array:
        assert self.folder is not None
        try:
            return np.asarray(np.load(self.folder / f"{name}.npy", mmap_mode="r"))
        except (OSError, ValueError) as error:
            raise self._damage() from error

    def _damage(self) -> MissingFileError:
        return MissingFileError(
            f"the decoded cache {self.folder} was removed or damaged while it was in use",
            hint="load the release again: rema_data.load builds it",
            path=str(self.folder),
        )

    def __getstate__(self) -> dict[str, Any]:
        return {"folder": self.folder}


class MemoryCache(DecodedCache):
    """A decoded release in memory. Pickling copies it: workers that are forked share it, spawned ones do not."""

    def __init__(self, maps: MapArrays, index: Index, categories: Categories) -> None:
        self.folder = None
        self.__dict__.update(maps=maps, index=index, categories=categories)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__


def caches_folder() -> Path:
    """Where decoded caches lie by default: ``REMA_HOME/decoded``."""
    return rema_home() / "decoded"


def cache_name(release: ReleaseFolder, blocks: Sequence[BlockEntry]) -> str:
    """Name of the cache of some blocks of a release."""
    listed = json.dumps([CACHE_VERSION, [block.key.path for block in blocks]])
    return f"{release.manifest.sha256[:16]}-{hashlib.sha256(listed.encode()).hexdigest()[:8]}"
