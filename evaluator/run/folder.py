"""The run folder: its identity, its lock, and what every writing process did."""

from __future__ import annotations

import errno
import json
import secrets
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from evaluator.run.environment import environment
from evaluator.run.header import RUN_FILE, RUN_FORMAT, encode_header, read_header
from evaluator.run.seal import ACTIONS_FILE, OLD_RESULTS_FILE, RESULTS_FILE, SUMMARY_FILE, seal_of
from rema_data.errors import InputError, RunMismatchError
from rema_data.locks import Busy, has_no_locks, lock
from rema_data.storage import storage_errors, write_atomic

__all__ = ["RunFolder", "being_written", "locked"]

TIMINGS_FILE = "timings.parquet"
_LOG_FILE = "policy.log"
_LOCK_FILE = ".lock"
_LOCAL = "choose a folder on a local disk with --output"
_NOT_WRITABLE = (errno.EACCES, errno.EPERM, errno.EROFS)
_RESULTS = (RESULTS_FILE, OLD_RESULTS_FILE, SUMMARY_FILE)
_FILES = (RUN_FILE, RESULTS_FILE, ACTIONS_FILE, TIMINGS_FILE, SUMMARY_FILE, _LOG_FILE)
_OF_EARLIER_FORMATS = (OLD_RESULTS_FILE, "leaves.bin", "run.json.sig")
"""What a run that is sealed again has no use for."""


@contextmanager
def locked(folder: Path, hint: str, *, only_reading: bool = False) -> Iterator[None]:
    """Hold a run folder for this process alone; an InputError with ``hint`` where another process holds it.

    A reader (``only_reading``) of a folder that cannot be written continues without the lock.
    """
    with ExitStack() as stack:
        try:
            with storage_errors(folder):
                try:
                    stack.enter_context(lock(folder / _LOCK_FILE, hint=_LOCAL))
                except OSError as error:
                    if not only_reading or not (error.errno in _NOT_WRITABLE or has_no_locks(error.__cause__)):
                        raise
        except Busy as error:
            raise InputError(f"another process is writing in {folder}", hint=hint, path=str(folder)) from error
        yield


def being_written(folder: Path) -> bool:
    """Whether a process is writing in a run folder at this moment, as far as this process may ask."""
    if not (folder / _LOCK_FILE).exists():
        return False
    try:
        with lock(folder / _LOCK_FILE):
            return False
    except Busy:
        return True
    except OSError:
        return False


class RunFolder:
    """``run.json`` (``header``) and the paths of a run. Use ``RunFolder.locked``."""

    def __init__(self, path: Path, header: dict[str, Any]) -> None:
        self.path = path
        self.header = header
        self._begun = False
        self._episodes = int(header["episodes"])
        self._sealed = self._content() if "seal" in header else None

    @property
    def records(self) -> Path:
        """Folder of the journals."""
        return self.path / "records"

    @property
    def repeats(self) -> Path:
        """Folder of the journals of the audit."""
        return self.records / "audit"

    @property
    def segment(self) -> int:
        """Number under which this process writes, or would."""
        return len(self.header["segments"]) + (0 if self._begun else 1)

    @property
    def salt(self) -> str:
        """What the order of the questions depends on: drawn for this folder, told to no policy."""
        return str(self.header["salt"])

    @staticmethod
    @contextmanager
    def locked(path: Path, identity: Mapping[str, Any], episodes: int) -> Iterator[RunFolder]:
        """Open the folder of a run for this process alone; create it where it is missing.

        ``identity`` is everything that two processes must share to write in one folder, ready for JSON; more
        ``episodes`` extend the run. A folder without records and results is taken over. What a killed process left
        half-written is deleted.

        Raises RunMismatchError (naming field and both values) where the folder belongs to another run, InputError where
        another process writes in it or it holds records without a ``run.json``.
        """
        with storage_errors(path):
            path.mkdir(parents=True, exist_ok=True)
        with locked(path, "wait for it, or choose another folder with --output"):
            _sweep(path)
            folder = RunFolder(path, _header(path, identity))
            folder._check(identity, episodes)
            folder.save()
            yield folder

    def _check(self, identity: Mapping[str, Any], episodes: int) -> None:
        wanted = json.loads(json.dumps(dict(identity)))
        if not any(self.records.glob("*.jsonl")) and not any((self.path / name).exists() for name in _RESULTS):
            # Nothing was recorded (the policy did not import, say): what comes now may be another run.
            self.header.update(identity=wanted, policy={}, episodes=episodes, segments=[])
        for field, value in wanted.items():
            recorded = self.header["identity"].get(field)
            if recorded != value:
                changed = "the policy has changed since: " if field == "policy_digest" else ""
                raise RunMismatchError(
                    f"{self.path} belongs to another run: {changed}its {field} is {recorded}, this one's is {value}",
                    hint="choose another folder with --output, or delete this one",
                    path=str(self.path),
                    field=field,
                    recorded=recorded,
                    wanted=value,
                )
        if episodes < self.header["episodes"]:
            raise RunMismatchError(
                f"{self.path} belongs to another run: its episodes are "
                f"{self.header['episodes']}, this one's {episodes}",
                hint=f"give --episodes {self.header['episodes']} or more, or choose another folder with --output",
                path=str(self.path),
                field="episodes",
                recorded=self.header["episodes"],
                wanted=episodes,
            )
        self._episodes = episodes  # written to the header when more are played: until then its seal holds

    def begin_segment(self, **facts: Any) -> None:
        """Note in ``run.json`` that this process is about to write; once. An earlier summary is removed."""
        if self._begun:
            return
        (self.path / SUMMARY_FILE).unlink(missing_ok=True)
        self.header["episodes"] = self._episodes
        self.header["segments"].append({"number": self.segment, **environment(), **facts})
        self._begun = True
        self.save()

    def note_segment(self, **facts: Any) -> None:
        """Add facts to this process's entry, if it wrote anything."""
        if self._begun:
            self.header["segments"][-1].update(facts)
            self.save()

    def set_policy(self, **facts: Any) -> None:
        """Add facts about the policy that show once it runs."""
        self.header["policy"].update(facts)
        self.save()

    def save(self) -> None:
        """Write ``run.json`` atomically, without its seal where that is of another content."""
        if self._sealed is not None and self._content() != self._sealed:
            self.header.pop("seal", None)
            self.header.pop("end", None)
            self._sealed = None
        self.write(RUN_FILE, encode_header(self.header))

    def _content(self) -> str:
        return encode_header({name: value for name, value in self.header.items() if name != "seal"})

    def prepare_seal(self, end: Mapping[str, Any]) -> None:
        """Note in ``run.json`` what the summary needs besides the rows; the seal follows."""
        self._sealed = None
        self.header.pop("seal", None)
        self.header.update(format=RUN_FORMAT, episodes=self._episodes, end=dict(end))

    def seal(self, files: Mapping[str, bytes]) -> None:
        """Put a seal over ``run.json`` and ``files``, results and action log, which are written already."""
        self.header["seal"] = seal_of(self.header, files)
        self._sealed = self._content()
        self.save()
        for name in _OF_EARLIER_FORMATS:
            (self.path / name).unlink(missing_ok=True)

    @property
    def policy_log(self) -> Path:
        """Where the policy's prints are kept; missing if there were none."""
        return self.path / _LOG_FILE

    def write(self, name: str, data: bytes | str) -> None:
        """Write a file of the folder atomically."""
        write_atomic(self.path / name, data)


def _sweep(path: Path) -> None:
    """Remove the temporary files of writers that were killed; the lock says that no process is writing now."""
    for name in _FILES:
        for left in path.glob(f".{name}.*"):
            left.unlink(missing_ok=True)


def _header(path: Path, identity: Mapping[str, Any]) -> dict[str, Any]:
    if (path / RUN_FILE).exists():
        return read_header(path)[0]
    if any((path / "records").glob("*.jsonl")):
        raise InputError(
            f"{path} has records but no {RUN_FILE}", hint="choose another folder with --output", path=str(path)
        )
    return {
        "format": RUN_FORMAT,
        "identity": json.loads(json.dumps(dict(identity))),
        "policy": {},
        "episodes": 0,
        "salt": secrets.token_hex(16),
        "segments": [],
    }
