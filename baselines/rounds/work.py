"""The work folder of a collection: ``.NAME.collecting`` beside the release that it becomes.

::

    plan.json            whom it belongs to
    chunks/*.npz         written under a temporary name, synced and renamed
    log/log-0001.jsonl   one line a committed chunk: name, sha256, episodes, steps; synced before the next one
    sealing/             the release while it is being sealed
    policy-*.log         what the policies printed

Only a chunk whose line is in the log and whose bytes have that sha256 counts; everything else is played again.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from baselines.rounds.chunk import Chunk, EncodedChunk
from evaluator.run.records import Journal, read_journal
from rema_data.errors import InputError, IntegrityError, RunMismatchError
from rema_data.storage import storage_errors, write_atomic

__all__ = ["WorkFolder", "work_path"]

_LOG = "log"


def work_path(output: Path, name: str) -> Path:
    """Where the release ``name`` is collected."""
    return output / f".{name}.collecting"


class WorkFolder:
    """The committed chunks of a collection. Use ``WorkFolder.locked``.

    Attributes
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        folder = path / _LOG
        segments = [int(file.stem.rpartition("-")[2]) for file in folder.glob(f"{_LOG}-*.jsonl")]
        self._committed: dict[str, str] = {row["chunk"]: row["sha256"] for _, row in read_journal(folder, _LOG)}
        self._journal = Journal(folder, _LOG, max(segments, default=0) + 1)

    @staticmethod
    @contextmanager
    def locked(path: Path, identity: Mapping[str, Any]) -> Iterator[WorkFolder]:
        """Open the folder for this process alone, creating it where it is missing.

        Parameters
        ----------
        path : Path
        identity : mapping
            Everything that decides a byte of a chunk, ready for JSON.

        Raises
        ------
        InputError
            Another process is collecting there.
        RunMismatchError
            It holds chunks of another plan.
        IntegrityError
            A line of its log is damaged.
        """
        with storage_errors(path):
            path.mkdir(parents=True, exist_ok=True)
            lock = FileLock(path / ".lock", timeout=0)
            try:
                lock.acquire()
            except Timeout as error:
                raise InputError(
                    f"another process is collecting in {path}",
                    hint="wait for it, or choose another folder with --output",
                    path=str(path),
                ) from error
        try:
            _check_owner(path, identity)
            _sweep(path)
            folder = WorkFolder(path)
            try:
                yield folder
            finally:
                folder._journal.close()
        finally:
            lock.release()

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

    def read(self, chunk: Chunk) -> EncodedChunk:
        """A committed chunk.

        Raises
        ------
        IntegrityError
            It is not whole any more.
        """
        data = self._data(chunk)
        if data is None:
            raise IntegrityError(
                f"chunk {self._file(chunk)} was damaged or removed while it was in use",
                hint="run the same command again: it is played again",
                path=str(self._file(chunk)),
            )
        return EncodedChunk.from_bytes(data)

    def commit(self, chunk: Chunk, encoded: EncodedChunk) -> None:
        """Make a chunk durable, then say so in the log.

        Raises
        ------
        StorageError
            The disk is full or may not be written; the chunk is not committed.
        """
        data = encoded.to_bytes()
        write_atomic(self._file(chunk), data)
        sha256 = hashlib.sha256(data).hexdigest()
        counts = {"episodes": encoded.episodes.num_rows, "steps": encoded.steps.num_rows}
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
    wanted = json.loads(json.dumps(identity))
    if any((path / _LOG).glob(f"{_LOG}-*.jsonl")):
        try:
            recorded = json.loads(file.read_bytes())
        except (OSError, ValueError):
            recorded = None
        if recorded != wanted:
            raise RunMismatchError(
                f"{path} holds episodes of another plan{_difference(recorded, wanted)}",
                hint=f"undo the change, choose another folder with --output, or delete {path}",
                path=str(path),
                recorded=recorded,
                wanted=wanted,
            )
    write_atomic(file, json.dumps(wanted, indent=1) + "\n")


def _difference(recorded: Any, wanted: dict[str, Any]) -> str:
    if not isinstance(recorded, dict):
        return ": its plan.json cannot be read"
    fields = [name for name in {**recorded, **wanted} if recorded.get(name) != wanted.get(name)]
    return f": they differ in {', '.join(fields)}"


def _sweep(path: Path) -> None:
    """Remove the temporary files of a process that was killed; the lock says that no process is writing now."""
    for folder, pattern in ((path, ".plan.json.*"), (path / "chunks", ".*.npz.*")):
        for left in folder.glob(pattern):
            left.unlink(missing_ok=True)
