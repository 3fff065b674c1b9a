"""The decoded cache: plain arrays on disk, built once by one process and mapped by all that read.

::

    <folder>/<manifest sha256, 16 digits>-<hash of the local blocks, 8 digits>/
        scene.npy  ee_depth.npy  ee_mask.npy     one row a scene, one a different end-effector map
        index.npy                                one row a step
        cache.json                               written last: see ``rema_data.loader.record``

The folder is disposable: ``rema_data.load`` builds it again. It gets its name only when it is whole and on the disk.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import os
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rema_data.errors import MissingFileError, StorageError
from rema_data.loader.decode import MAP_ARRAYS, Progress, decode_blocks, map_rows, row_bytes
from rema_data.loader.index import Categories, Index
from rema_data.loader.record import CACHE_VERSION, is_whole, read_record, write_record
from rema_data.schema import Embodiment
from rema_data.storage import rema_home, storage_errors, sync_folder

if TYPE_CHECKING:
    from rema_data.release.folder import ReleaseFolder
    from rema_data.release.manifest import BlockEntry

__all__ = [
    "CACHE_VERSION",
    "DecodedCache",
    "MapArrays",
    "cache_name",
    "caches_folder",
    "decode_to_memory",
    "is_whole",
    "open_cache",
]

_LOG = logging.getLogger(__name__)
_HINT = "set REMA_HOME to another folder, or use rema_data.load(..., cache=FOLDER), or cache='memory'"
_MAX_JOBS = 4
Array = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class MapArrays:
    """The decoded maps.

    Attributes
    ----------
    scene : int16 (steps, 64, 64)
        Height above the table, 0.1 mm.
    ee_depth : int16 (maps, 2, 112, 112)
        Height above the end effector's lowest allowed point, 0.1 mm.
    ee_mask : uint8 (maps, 2, 112, 14)
        Packed: see ``rema_data.heights.unpack_mask``.
    """

    scene: Array
    ee_depth: Array
    ee_mask: Array


class DecodedCache:
    """A decoded release: on disk when it has a ``folder``, else in this process's memory.

    Only the folder's path is pickled: every process maps the files for itself, when it first reads.
    """

    def __init__(self, folder: Path) -> None:
        self.folder: Path | None = folder

    @cached_property
    def _record(self) -> dict[str, Any]:
        return read_record(self._path)

    @property
    def _path(self) -> Path:
        assert self.folder is not None
        return self.folder

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
        found: Categories = self._record["categories"]
        return found

    def _map(self, name: str) -> Array:
        try:
            return np.asarray(np.load(self._path / f"{name}.npy", mmap_mode="r"))
        except (OSError, ValueError) as error:
            raise MissingFileError(
                f"the decoded cache {self._path} was removed or damaged while it was in use",
                hint="load the release again: rema_data.load builds it anew",
                path=str(self._path),
            ) from error

    def __getstate__(self) -> dict[str, Any]:
        return {"folder": self.folder}


class _MemoryCache(DecodedCache):
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


def open_cache(
    release: ReleaseFolder,
    blocks: Sequence[BlockEntry],
    folder: Path | None = None,
    progress: Progress | None = None,
) -> DecodedCache:
    """The cache of some blocks, built where it is missing or damaged; one process builds, others wait for it.

    Parameters
    ----------
    release : ReleaseFolder
    blocks : sequence of BlockEntry
        Blocks that are on this machine.
    folder : Path, optional
        Of all caches; by default ``REMA_HOME/decoded``.
    progress : callable, optional

    Raises
    ------
    StorageError
        The folder cannot be written or is full.
    IntegrityError, MissingFileError
        A file of the release is damaged or gone.
    """
    folder = caches_folder() if folder is None else folder
    path = folder / cache_name(release, blocks)
    if not is_whole(path):
        from filelock import FileLock, Timeout  # only a builder needs it: a ready cache opens without

        with _cache_errors(path):
            folder.mkdir(parents=True, exist_ok=True)
            lock = FileLock(folder / f"{path.name}.lock")
            try:
                lock.acquire(timeout=1.0)
            except Timeout:
                _LOG.info("waiting for another process that decodes %s", release.manifest.name)
                lock.acquire()
        try:
            if not is_whole(path):
                _build(release, blocks, path, progress)
        finally:
            lock.release()
    return DecodedCache(path)


def decode_to_memory(
    release: ReleaseFolder, blocks: Sequence[BlockEntry], progress: Progress | None = None
) -> DecodedCache:
    """Blocks decoded into the memory of this process; raises as ``open_cache`` does, but for StorageError."""
    arrays = {
        name: np.empty((rows, *MAP_ARRAYS[name][1]), MAP_ARRAYS[name][0]) for name, rows in map_rows(blocks).items()
    }
    sink = _MemorySink(arrays)
    index, categories = decode_blocks(release, blocks, sink, jobs=_jobs(), progress=progress)
    maps = MapArrays(**arrays)
    share_repeats(index, categories, maps)
    for array in (*arrays.values(), index):
        array.setflags(write=False)
    return _MemoryCache(maps, index, categories)


def _jobs() -> int:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, _MAX_JOBS)


def _build(release: ReleaseFolder, blocks: Sequence[BlockEntry], path: Path, progress: Progress | None) -> None:
    """Decode into a temporary folder and give it its name. The caller holds the lock."""
    began = time.perf_counter()
    for stale in path.parent.glob(f".{path.name}.*"):  # of a builder that was killed: it cannot hold the lock
        shutil.rmtree(stale, ignore_errors=True)
    rows = map_rows(blocks)
    size = sum(count * row_bytes(name) for name, count in rows.items())
    _LOG.info("decoding %s once into %s (%.0f MB)", release.manifest.name, path, size / 1e6)
    with _cache_errors(path):
        _check_space(path, size)
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    try:
        with _cache_errors(path):
            sink = _FileSink(temporary, rows)
        index, categories = decode_blocks(release, blocks, sink, jobs=_jobs(), progress=progress)
        share_repeats(index, categories, sink.open())
        with _cache_errors(path):
            np.save(temporary / "index.npy", index)
            files = sorted(temporary.iterdir())
            for file in files:
                _sync(file)
            about = {
                "release": release.manifest.name,
                "sha256": release.manifest.sha256,
                "blocks": [block.key.path for block in blocks],
                "categories": categories,
            }
            write_record(temporary, files, about)
            temporary.chmod(0o755)
            if path.exists():
                shutil.rmtree(path)
            temporary.rename(path)
            sync_folder(path.parent)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    seconds = time.perf_counter() - began
    _LOG.info("decoded %s in %.1f s (%.0f MB/s)", release.manifest.name, seconds, size / 1e6 / seconds)


@contextmanager
def _cache_errors(path: Path) -> Iterator[None]:
    """As ``storage_errors``, with the ways around a cache that cannot be written."""
    try:
        with storage_errors(path):
            yield
    except StorageError as error:
        raise StorageError(error.message, hint=_HINT, **error.facts) from error


def _check_space(path: Path, needed: int) -> None:
    free = shutil.disk_usage(path.parent).free
    if free < needed:
        raise StorageError(
            f"the decoded cache {path} needs {needed / 1e6:.0f} MB, {free / 1e6:.0f} MB are free",
            path=str(path),
            needed=needed,
            free=free,
        )


def _sync(path: Path) -> None:
    with path.open("rb+") as file:
        os.fsync(file.fileno())


class _MemorySink:
    def __init__(self, arrays: dict[str, Array]) -> None:
        self._arrays = arrays

    def put(self, name: str, start: int, rows: Array) -> None:
        self._arrays[name][start : start + len(rows)] = rows


class _FileSink:
    """``.npy`` files that are filled in any order. Plain writes: a full disk is an error, and not a bus error."""

    def __init__(self, folder: Path, rows: dict[str, int]) -> None:
        self._folder = folder
        self._begin: dict[str, int] = {}
        for name, count in rows.items():
            dtype, shape = MAP_ARRAYS[name]
            header = io.BytesIO()
            np.lib.format.write_array_header_1_0(
                header, {"descr": dtype, "fortran_order": False, "shape": (count, *shape)}
            )
            self._begin[name] = header.tell()
            with (folder / f"{name}.npy").open("wb") as file:
                file.write(header.getvalue())
                file.truncate(header.tell() + count * row_bytes(name))

    def put(self, name: str, start: int, rows: Array) -> None:
        path = self._folder / f"{name}.npy"
        with _cache_errors(path), path.open("rb+") as file:
            file.seek(self._begin[name] + start * row_bytes(name))
            file.write(np.ascontiguousarray(rows).data)

    def open(self) -> MapArrays:
        return DecodedCache(self._folder).maps


def share_repeats(index: Index, categories: Categories, maps: MapArrays) -> None:
    """Point steps with a bare gripper at one map where several blocks hold the same, so that it stays in the caches.

    Within a block equal maps are stored once; across blocks it is the bare gripper's that repeat.
    """
    bare = np.isin(index["embodiment"], [n for n, name in enumerate(categories["embodiment"]) if Embodiment(name).bare])
    first: dict[bytes, int] = {}
    target = {}
    for row in np.unique(index["ee_row"][bare]).tolist():
        digest = hashlib.blake2b(maps.ee_depth[row]).digest() + hashlib.blake2b(maps.ee_mask[row]).digest()
        target[row] = first.setdefault(digest, row)
    if target:
        lookup = np.arange(max(target) + 1, dtype=np.int32)
        lookup[list(target)] = list(target.values())
        index["ee_row"][bare] = lookup[index["ee_row"][bare]]
