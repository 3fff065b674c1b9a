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
import shlex
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import pyarrow as pa
import pydantic
from typing_extensions import TypedDict  # pydantic needs this one before Python 3.12

from baselines.rounds.plan import BlockPlan
from evaluator.run.records import Journal, read_journal
from rema_data.bounded import npz_arrays, parquet_table
from rema_data.errors import InputError, IntegrityError, RunMismatchError
from rema_data.json_files import read_json
from rema_data.locks import Busy, lock
from rema_data.storage import storage_errors, write_atomic
from rema_data.store.block import BlockKey, EncodedMaps
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS
from rema_data.store.maps import ARRAYS
from rema_data.store.tables import as_stored, checked_table, to_parquet

__all__ = ["CHUNK_EPISODES", "Chunk", "WorkFolder", "cut", "encoded", "work_path"]

CHUNK_EPISODES = 250
"""Some seconds of work: what is lost at most when a collection is killed, a few times over."""
Content = tuple[pa.Table, pa.Table, EncodedMaps]
"""Episodes, steps and maps, as ``encode_episodes`` gives and ``BlockWriter.append`` takes them."""
_LOG = "log"
_TABLES = ("episodes", "steps")
_COLUMNS = (EPISODE_COLUMNS, STEP_COLUMNS)
_MAPS = ("scene", "ee_row", "ee_depth", "ee_mask")
_MOST_STEPS = 100_000
"""Of a chunk: a line that names more is damaged."""
_TABLE_BYTES, _ROW_BYTES = 1 << 20, 1 << 10
"""What a table of a chunk may take as Parquet: so much, and so much more a row."""


@pydantic.with_config(pydantic.ConfigDict(extra="forbid", strict=True))
class _Commit(TypedDict):
    """A line of the log."""

    chunk: str
    sha256: str
    episodes: Annotated[int, pydantic.Field(ge=0, le=_MOST_STEPS)]
    steps: Annotated[int, pydantic.Field(ge=0, le=_MOST_STEPS)]


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
        name: np.frombuffer(to_parquet(as_stored(table, columns)), np.uint8)
        for name, table, columns in zip(_TABLES, tables, _COLUMNS, strict=True)
    }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays, **{name: getattr(maps, name) for name in _MAPS})
    return buffer.getvalue()


def _decoded(data: bytes, episodes: int, steps: int) -> Content:
    """Inverse of ``encoded`` for a chunk of so many episodes and steps; a ValueError for anything else."""
    forms = {name: (form.dtype, form.row) for name, form in ARRAYS.items()}
    rows = dict.fromkeys(_TABLES, ("uint8", ())) | {"ee_row": ("int32", ())} | forms
    most = dict.fromkeys(_TABLES, _TABLE_BYTES + steps * _ROW_BYTES) | dict.fromkeys(("ee_row", *forms), steps)
    arrays = npz_arrays(data, rows, most)
    try:
        tables = [
            checked_table(parquet_table(arrays[name].tobytes(), count), columns)
            for name, count, columns in zip(_TABLES, (episodes, steps), _COLUMNS, strict=True)
        ]
    except pa.ArrowException as error:
        raise ValueError(f"a table of it cannot be read: {error}") from error
    maps = EncodedMaps(**{name: arrays[name] for name in _MAPS})
    counts = (tables[0].num_rows, tables[1].num_rows, len(maps.scene), len(maps.ee_row))
    used = maps.ee_row
    if counts != (episodes, steps, steps, steps) or len(maps.ee_depth) != len(maps.ee_mask):
        raise ValueError(f"it has other counts than {episodes} episodes and {steps} steps")
    if steps and not 0 <= used.min() <= used.max() < len(maps.ee_depth):
        raise ValueError("it points at maps that it does not have")
    return tables[0], tables[1], maps


def work_path(output: Path, name: str) -> Path:
    """Where the release ``name`` is collected."""
    return output / f".{name}.collecting"


class WorkFolder:
    """The committed chunks of a collection. Use ``WorkFolder.locked``."""

    def __init__(self, path: Path) -> None:
        self.path = path
        folder = path / _LOG
        numbers = [file.stem.removeprefix(f"{_LOG}-") for file in folder.glob(f"{_LOG}-*.jsonl")]
        segments = [int(digits) for digits in numbers if digits.isdecimal()]
        rows = read_journal(folder, _LOG, _Commit)
        self._committed = {row["chunk"]: _Commit(**row) for _, row in rows}  # type: ignore[typeddict-item]
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
        committed = self._committed.get(chunk.name)
        if committed is None:
            return None
        with storage_errors(self._file(chunk)):
            try:
                data = self._file(chunk).read_bytes()
            except FileNotFoundError:
                return None
        return data if hashlib.sha256(data).hexdigest() == committed["sha256"] else None

    def read(self, chunk: Chunk) -> Content:
        """A committed chunk; raises IntegrityError where it is not whole any more."""
        data = self._data(chunk)
        if data is None:
            raise IntegrityError(
                f"chunk {self._file(chunk)} was damaged or removed while it was in use",
                hint="run the same command again: it plays the chunk again",
                path=str(self._file(chunk)),
            )
        committed = self._committed[chunk.name]
        try:
            return _decoded(data, committed["episodes"], committed["steps"])
        except ValueError as error:
            raise IntegrityError(
                f"chunk {self._file(chunk)} is not one of this rema: {error}",
                hint=f"delete it, and run the same command again: rm {shlex.quote(str(self._file(chunk)))}",
                path=str(self._file(chunk)),
            ) from error

    def commit(self, chunk: Chunk, content: Content) -> None:
        """Make a chunk durable, then say so in the log; StorageError where it could not be committed."""
        data = encoded(content)
        write_atomic(self._file(chunk), data)
        episodes, steps = (table.num_rows for table in content[:2])
        line = _Commit(chunk=chunk.name, sha256=hashlib.sha256(data).hexdigest(), episodes=episodes, steps=steps)
        self._journal.append([dict(line)])
        self._journal.sync()
        self._committed[chunk.name] = line

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
            recorded = read_json(file)
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
