"""Builds the decoded cache of a release, on disk or in memory; see ``cache`` for what is in it.

One process builds, others wait for it. A cache gets its name only when it is whole and on the disk.
"""

from __future__ import annotations

import hashlib
import io
import logging
import os
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rema_data import interrupts
from rema_data.errors import StorageError
from rema_data.loader.cache import DecodedCache, MapArrays, MemoryCache, cache_name, caches_folder
from rema_data.loader.decode import MAP_ARRAYS, decode_blocks, map_rows, row_bytes
from rema_data.loader.index import Categories, Index
from rema_data.loader.record import is_whole, write_record
from rema_data.locks import lock
from rema_data.progress import Progress
from rema_data.schema import Embodiment
from rema_data.storage import not_written, storage_errors, sync_file, sync_folder

if TYPE_CHECKING:
    from rema_data.release.folder import ReleaseFolder
    from rema_data.release.manifest import BlockEntry

__all__ = ["decode_to_memory", "open_cache"]

_LOG = logging.getLogger(__name__)
_HINT = "set REMA_HOME to another folder, or use rema_data.load(..., cache=FOLDER), or cache='memory'"
_MAX_JOBS = 4
Array = npt.NDArray[Any]


def open_cache(
    release: ReleaseFolder,
    blocks: Sequence[BlockEntry],
    folder: Path | None = None,
    progress: Progress | None = None,
) -> DecodedCache:
    """The cache of some local blocks, built where it is missing or damaged; one process builds, others wait for it.

    ``folder`` holds all caches: by default ``REMA_HOME/decoded``. Raises StorageError where it cannot be written or is
    full, IntegrityError or MissingFileError for a file of the release.
    """
    folder = caches_folder() if folder is None else folder
    path = folder / cache_name(release, blocks)
    if not is_whole(path):
        waiting = partial(_LOG.info, "waiting for another process that decodes %s", release.manifest.name)
        with ExitStack() as stack:
            with _cache_errors(path):
                folder.mkdir(parents=True, exist_ok=True)
                stack.enter_context(lock(folder / f"{path.name}.lock", wait=True, waiting=waiting))
            if not is_whole(path):
                _build(release, blocks, path, progress)
    return DecodedCache(path)


def decode_to_memory(
    release: ReleaseFolder, blocks: Sequence[BlockEntry], progress: Progress | None = None
) -> DecodedCache:
    """Blocks decoded into the memory of this process; raises as ``open_cache`` does, but for StorageError."""
    arrays = {
        name: np.empty((rows, *MAP_ARRAYS[name][1]), MAP_ARRAYS[name][0]) for name, rows in map_rows(blocks).items()
    }

    def put(name: str, start: int, rows: Array) -> None:
        arrays[name][start : start + len(rows)] = rows

    index, categories = decode_blocks(release, blocks, put, jobs=_jobs(), progress=progress)
    maps = MapArrays(**arrays)
    share_repeats(index, categories, maps)
    for array in (*arrays.values(), index):
        array.setflags(write=False)
    return MemoryCache(maps, index, categories)


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
        index, categories = decode_blocks(release, blocks, sink.put, jobs=_jobs(), progress=progress)
        share_repeats(index, categories, sink.open())
        with _cache_errors(path):
            np.save(temporary / "index.npy", index)
            sink.check()
            if not np.array_equal(np.load(temporary / "index.npy"), index):
                raise not_written(path / "index.npy")
            files = sorted(temporary.iterdir())
            for file in files:
                sync_file(file)
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
    """As ``storage_errors``, with hints for a cache that cannot be written."""
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


class _FileSink:
    """``.npy`` files that are filled in any order. Plain writes: a full disk is an error, and not a bus error."""

    def __init__(self, folder: Path, rows: dict[str, int]) -> None:
        self._folder = folder
        self._begin: dict[str, int] = {}
        self._digests: dict[tuple[str, int, int], bytes] = {}  # of what was put, by array, first row and bytes
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
            data = np.ascontiguousarray(rows).data
            file.seek(self._begin[name] + start * row_bytes(name))
            file.write(data)
            self._digests[name, start, data.nbytes] = hashlib.sha256(data).digest()

    def check(self) -> None:
        """Read everything back; StorageError where it is not what was put."""
        for (name, start, size), digest in sorted(self._digests.items()):
            interrupts.check()
            path = self._folder / f"{name}.npy"
            with path.open("rb") as file:
                file.seek(self._begin[name] + start * row_bytes(name))
                if hashlib.sha256(file.read(size)).digest() != digest:
                    raise not_written(path)

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
