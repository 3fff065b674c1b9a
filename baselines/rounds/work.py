"""The work folder of a collection: ``.NAME.collecting`` beside the release that it becomes.

Episodes are played, stored and committed in chunks: some consecutive episodes of one block.

::

    plan.json            what decides a byte of a chunk
    chunks/*.npz         written under a temporary name, synced and renamed
    log/log-0001.jsonl   one line a committed chunk: name, sha256, episodes, steps; synced before the next one
    sealing/             the release while it is being sealed
    policy-*.log         what the policies printed

Only a chunk whose line is in the log and whose bytes have that sha256 counts; everything else is played again.
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from baselines.rounds.plan import BlockPlan
from evaluator.run.records import Journal, read_journal
from rema_data.errors import InputError, IntegrityError, RunMismatchError
from rema_data.locks import Busy, lock
from rema_data.storage import storage_errors, write_atomic
from rema_data.store.block import BlockKey, EncodedMaps
from rema_data.store.tables import to_parquet

__all__ = ["CHUNK_EPISODES", "Chunk", "WorkFolder", "cut", "encoded", "work_path"]

CHUNK_EPISODES = 250
"""Some seconds of work: what is lost at most when a collection is killed, a few times over."""
Content = tuple[pa.Table, pa.Table, EncodedMaps]
"""Episodes, steps and maps, as ``encode_episodes`` gives and ``BlockWriter.append`` takes them."""
_LOG = "log"
_TABLES = ("episodes", "steps")
_MAPS = ("scene", "ee_row", "ee_depth", "ee_mask")


class Chunk(NamedTuple):
    """Episodes ``start`` to ``stop`` of a block."""

    block: BlockKey
    start: int
    stop: int

    @property
    def name(self) -> str:
        """Name of its file, and of its line in the log."""
        return f"round-{self.block.round}-{self.block.task}-{self.block.split}-{self.start:07d}"


def cut(blocks: Sequence[BlockPlan], episodes: int = CHUNK_EPISODES) -> Iterator[Chunk]:
    """The chunks of some blocks, in order."""
    for block in blocks:
        for start in range(0, block.episodes, episodes):
            yield Chunk(block.key, start, min(start + episodes, block.episodes))


def encoded(content: Content) -> bytes:
    """A compressed npz of the maps and of both tables as Parquet bytes."""
    *tables, maps = content
    arrays: dict[str, Any] = {
        name: np.frombuffer(to_parquet(table), np.uint8) for name, table in zip(_TABLES, tables, strict=True)
    }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays, **{name: getattr(maps, name) for name in _MAPS})
    return buffer.getvalue()


def _decoded(data: bytes) -> Content:
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        episodes, steps = (pq.read_table(pa.BufferReader(arrays[name].tobytes())) for name in _TABLES)
        return episodes, steps, EncodedMaps(**{name: arrays[name] for name in _MAPS})


def work_path(output: Path, name: str) -> Path:
    """Where the release ``name`` is collected."""
    return output / f".{name}.collecting"


class WorkFolder:
    """The committed chunks of a collection. Use ``WorkFolder.locked``."""

    def __init__(self, path: Path) -> None:
        self.path = path
        folder = path / _LOG
        segments = [int(file.stem.rpartition("-")[2]) for file in folder.glob(f"{_LOG}-*.jsonl")]
        self._committed: dict[str, str] = {row["chunk"]: row["sha256"] for _, row in read_journal(folder, _LOG)}
        self._journal = Journal(folder, _LOG, max(segments, default=0) + 1)

    @staticmethod
    @contextmanager
    def locked(path: Path, identity: Mapping[str, Any]) -> Iterator[WorkFolder]:
        """Open the folder for this process alone; it is created where it is missing.

        ``identity`` is what decides a byte of a chunk. Raises InputError where another process collects there,
        RunMismatchError where it holds chunks of another plan, IntegrityError where a line of its log is damaged.
        """
        with ExitStack() as stack:
            with storage_errors(path):
                path.mkdir(parents=True, exist_ok=True)
                try:
                    stack.enter_context(lock(path / ".lock", hint="choose a folder on a local disk with --output"))
                except Busy as error:
                    raise InputError(
                        f"another process is collecting in {path}",
                        hint="wait for it, or choose another folder with --output",
                        path=str(path),
                    ) from error
            _check_owner(path, identity)
            _sweep(path)
            folder = WorkFolder(path)
            stack.callback(folder._journal.close)
            yield folder

    def _file(self, chunk: Chunk) -> Path:
        return self.path / "chunks" / f"{chunk.name}.npz"

    def has(self, chunk: Chunk) -> bool:
        """Whether the chunk is committed and whole."""
        return self._data(chunk) is not None

    def _data(self, chunk: Chunk) -> bytes | None:
        sha256 = self._committed.get(chunk.name)
        if sha256 is None:
            return None
        with storage_errors(self._file(chunk)):
            try:
                data = self._file(chunk).read_bytes()
            except FileNotFoundError:
                return None
        return data if hashlib.sha256(data).hexdigest() == sha256 else None

    def read(self, chunk: Chunk) -> Content:
        """A committed chunk; raises IntegrityError where it is not whole any more."""
        data = self._data(chunk)
        if data is None:
            raise IntegrityError(
                f"chunk {self._file(chunk)} was damaged or removed while it was in use",
                hint="run the same command again: it plays the chunk again",
                path=str(self._file(chunk)),
            )
        return _decoded(data)

    def commit(self, chunk: Chunk, content: Content) -> None:
        """Make a chunk durable, then say so in the log; StorageError where it could not be committed."""
        data = encoded(content)
        write_atomic(self._file(chunk), data)
        sha256 = hashlib.sha256(data).hexdigest()
        counts = {name: table.num_rows for name, table in zip(_TABLES, content[:2], strict=True)}
        self._journal.append([{"chunk": chunk.name, "sha256": sha256, **counts}])
        self._journal.sync()
        self._committed[chunk.name] = sha256

    def staging(self) -> Path:
        """An empty folder for the blocks of the release."""
        folder = self.path / "sealing"
        with storage_errors(folder):
            if folder.exists():
                shutil.rmtree(folder)
            folder.mkdir()
        return folder


def _check_owner(path: Path, identity: Mapping[str, Any]) -> None:
    """Take over an empty folder, and refuse one that belongs to another plan."""
    file = path / "plan.json"
    expected = json.loads(json.dumps(identity))
    if any((path / _LOG).glob(f"{_LOG}-*.jsonl")):
        try:
            recorded = json.loads(file.read_bytes())
        except (OSError, ValueError):
            recorded = None
        if recorded != expected:
            what = "its plan.json cannot be read"
            if isinstance(recorded, dict):
                names = [name for name in {**recorded, **expected} if recorded.get(name) != expected.get(name)]
                what = f"they differ in {', '.join(names)}"
            raise RunMismatchError(
                f"{path} holds episodes of another plan: {what}",
                hint=f"undo the change, choose another folder with --output, or delete {path}",
                path=str(path),
                recorded=recorded,
                expected=expected,
            )
    write_atomic(file, json.dumps(expected, indent=1) + "\n")


def _sweep(path: Path) -> None:
    """Remove the temporary files of a process that was killed; the lock says that no process is writing now."""
    for folder, pattern in ((path, ".plan.json.*"), (path / "chunks", ".*.npz.*")):
        for left in folder.glob(pattern):
            left.unlink(missing_ok=True)
