"""The run folder: who it belongs to, who is writing in it, and what every writing process did."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from rema_data.errors import InputError, IntegrityError, RunMismatchError
from rema_data.storage import storage_errors, write_atomic

__all__ = ["RunFolder"]

RUN_FORMAT = 1
_FILES = ("run.json", "episodes.parquet", "timings.parquet", "summary.json", "policy.log")
_HEADER = {"identity": dict, "policy": dict, "episodes": int, "segments": list}
_PACKAGES = ("rema", "numpy", "pybullet", "torch", "pyarrow", "scipy")


class RunFolder:
    """``run.json`` and the paths of a run. Use ``RunFolder.locked``.

    Attributes
    ----------
    path : Path
    header : dict
        Content of ``run.json``.
    """

    def __init__(self, path: Path, header: dict[str, Any]) -> None:
        self.path = path
        self.header = header
        self._begun = False

    @property
    def records(self) -> Path:
        """Folder of the journals."""
        return self.path / "records"

    @property
    def segment(self) -> int:
        """Number under which this process writes, or would."""
        return len(self.header["segments"]) + (0 if self._begun else 1)

    @staticmethod
    @contextmanager
    def locked(path: Path, identity: Mapping[str, Any], episodes: int) -> Iterator[RunFolder]:
        """Open the folder of a run for this process alone, creating it where it is missing.

        A folder without records belongs to nobody: it is taken over. What a killed process left half-written is
        swept away.

        Parameters
        ----------
        path : Path
        identity : mapping
            Everything that two processes must share to write in one folder, ready for JSON.
        episodes : int
            At least as many as the run has; more extend it.

        Raises
        ------
        RunMismatchError
            The folder belongs to another run; the message names the field and both values.
        InputError
            Another process is writing in it, or it holds records without a ``run.json``.
        """
        with storage_errors(path):
            path.mkdir(parents=True, exist_ok=True)
            lock = FileLock(path / ".lock", timeout=0)
            try:
                lock.acquire()
            except Timeout as error:
                raise InputError(
                    f"another process is writing in {path}",
                    hint="wait for it, or choose another folder with --output",
                    path=str(path),
                ) from error
        try:
            _sweep(path)
            folder = RunFolder(path, _read_header(path, identity))
            folder._check(identity, episodes)
            folder.save()
            yield folder
        finally:
            lock.release()

    def _check(self, identity: Mapping[str, Any], episodes: int) -> None:
        wanted = json.loads(json.dumps(dict(identity)))
        if not any(self.records.glob("*.jsonl")):
            # Nothing was recorded (the policy did not import, say): what comes now may be another run.
            self.header.update(identity=wanted, policy={}, episodes=0)
        for field, value in wanted.items():
            recorded = self.header["identity"].get(field)
            if recorded != value:
                raise RunMismatchError(
                    f"{self.path} belongs to another run: its {field} is {recorded}, this one's is {value}",
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
        self.header["episodes"] = episodes

    def begin_segment(self, **facts: Any) -> None:
        """Note in ``run.json`` that this process is about to write; once."""
        if self._begun:
            return
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
        """Write ``run.json`` atomically."""
        self.write("run.json", json.dumps(self.header, indent=2) + "\n")

    @property
    def policy_log(self) -> Path:
        """Where the policy's prints are kept; missing if there were none."""
        return self.path / "policy.log"

    def write(self, name: str, data: bytes | str) -> None:
        """Write a file of the folder atomically."""
        write_atomic(self.path / name, data)


def _sweep(path: Path) -> None:
    """Remove the temporary files of writers that were killed; the lock says that nobody is writing now."""
    for name in _FILES:
        for left in path.glob(f".{name}.*"):
            left.unlink(missing_ok=True)


def _read_header(path: Path, identity: Mapping[str, Any]) -> dict[str, Any]:
    file = path / "run.json"
    if not file.exists():
        if any((path / "records").glob("*.jsonl")):
            raise InputError(
                f"{path} has records but no run.json", hint="choose another folder with --output", path=str(path)
            )
        return {
            "format": RUN_FORMAT,
            "identity": json.loads(json.dumps(dict(identity))),
            "policy": {},
            "episodes": 0,
            "segments": [],
        }
    try:
        with storage_errors(file):
            header: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        known = header["format"] == RUN_FORMAT and all(isinstance(header[name], kind) for name, kind in _HEADER.items())
    except (ValueError, KeyError, TypeError):
        known = False
    if not known:
        raise IntegrityError(
            f"{file} is not a run header of this version",
            hint="choose another folder with --output",
            path=str(file),
        )
    return header


def environment() -> dict[str, Any]:
    """Where and with what this process runs: for people, and to see mixed hardware; no part of a run's identity."""
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {
            "host": hashlib.sha256(platform.node().encode()).hexdigest()[:8],
            "system": platform.system(),
            "architecture": platform.machine(),
            "processor": _processor(),
            "cores": os.cpu_count(),
        },
        "versions": {"python": platform.python_version(), **_versions()},
        **_commit(),
    }


def _versions() -> dict[str, str]:
    found = {}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _processor() -> str:
    if sys.platform == "linux":
        with suppress(OSError), open("/proc/cpuinfo", encoding="utf-8") as file:
            for line in file:
                if line.startswith("model name"):
                    return line.partition(":")[2].strip()
    return platform.processor()


def _commit() -> dict[str, Any]:
    """Commit of the checkout that this code runs from, and whether it was changed; null for an installed wheel."""
    root = Path(__file__).resolve().parents[2]
    if (root / ".git").exists():
        try:
            head = _git(root, "rev-parse", "HEAD")
            return {"commit": head, "dirty": bool(_git(root, "status", "--porcelain", "--untracked-files=no"))}
        except (OSError, subprocess.SubprocessError):
            pass
    return {"commit": None, "dirty": None}


def _git(root: Path, *arguments: str) -> str:
    # Without optional locks: looking must not write into the checkout.
    done = subprocess.run(
        ["git", "--no-optional-locks", *arguments], cwd=root, capture_output=True, text=True, timeout=10, check=True
    )
    return done.stdout.strip()
