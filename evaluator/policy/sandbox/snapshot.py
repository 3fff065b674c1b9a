"""A private copy of a policy's files and weights: the copy is hashed, and the copy is what runs.

Nothing that changes afterwards, or lies beside it, reaches the policy. Installed policies run from their package.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path

from evaluator.policy import imports
from evaluator.policy.loading import PolicySpec, check_checkpoint
from evaluator.policy.sandbox.allowlist import packages_folder
from evaluator.policy.sandbox.sources import Sources, checkpoint_sources, code_sources
from rema_data.commands import run_command
from rema_data.errors import InputError, MissingFileError, StorageError
from rema_data.storage import storage_errors

__all__ = ["Snapshot", "digest", "own_modules", "take_snapshot"]

_CHUNK = 1 << 20
_FICLONE = 0x40049409  # share the blocks of a file, where the file system can
_PARSE_S = 60.0
Hashes = list[tuple[str, str]]
"""Name and sha256 of every file."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What runs: copies in ``folder``, which no one else writes."""

    folder: Path
    policy: Path  # the file that is loaded
    checkpoint: Path | None
    digest: str
    read: tuple[Path, ...]  # what the process needs of it
    import_root: Path | None = None  # where the package of the file is imported from
    places: Mapping[Path, Path] = field(default_factory=dict)  # copy -> original
    hidden: tuple[Path, ...] = ()  # originals that must not be read beside their copies
    left_out: Mapping[Path, str] = field(default_factory=dict)  # original -> why it was not copied

    def original(self, text: str) -> str:
        """A text of the policy's process, with the paths that the user knows."""
        for copy, original in self.places.items():
            text = text.replace(str(copy), str(original))
        return text

    def moved(self, path: Path) -> Path:
        """Where a path lies in the copy of the code, if it does."""
        for copy, original in self.places.items():
            if path.is_relative_to(original):
                return copy / path.relative_to(original)
        return path


def take_snapshot(spec: PolicySpec, checkpoint: Path | None, folder: Path, hidden: Iterable[Path] = ()) -> Snapshot:
    """Copy a policy into ``folder`` (empty), without what is ``hidden``, and hash the copies.

    Raises MissingFileError where code or checkpoint is missing, InputError for what cannot be copied, StorageError
    where the copies do not fit.
    """
    weights = check_checkpoint(checkpoint)
    places: dict[Path, Path] = {}
    copy = None
    hashes: Hashes = []
    if weights is not None:
        copy = folder / "checkpoint" / weights.name
        hashes = _copied(checkpoint_sources(weights), copy)
        places[copy] = weights
    if spec.named is not None:
        read = (imports.outermost_folder(spec.path), *(place.parent for place in places))
        return Snapshot(folder, spec.path, copy, _identity(spec, _installed(spec), hashes), read, places=places)
    _must_exist(spec)
    sources = code_sources(spec.path, hidden)
    # Named like the original: a package is imported by the name of its folder.
    code = folder / "code" / (sources.root.name or "root")
    identity = _identity(spec, _named(spec, sources, _copied(sources, code)), hashes)
    places[code] = sources.root
    own = [packages_folder() / name for name in imports.PRODUCT]
    return Snapshot(
        folder,
        code / spec.path.relative_to(sources.root),
        copy,
        identity,
        tuple(place.parent for place in places),
        code.parent if (sources.root / "__init__.py").is_file() else None,
        places,
        tuple(path for path in sources.hidden if not any(path.is_relative_to(one) for one in own)),
        sources.left_out,
    )


def digest(spec: PolicySpec, checkpoint: Path | None) -> str:
    """Identity of a policy: sha256 over its class name, its code and its weights, hexadecimal.

    The code is every file that the policy may read of its folder (``code_sources``); of an installed policy, the file
    and the modules of its package that it imports. A checkpoint folder counts with all its files. A process that is
    started later runs from a copy, whose digest must be this one. Of a policy that is held, it is that of the copy.

    Raises MissingFileError where code or checkpoint is missing, InputError for what cannot be read.
    """
    if spec.copy is not None:
        return spec.copy.snapshot.digest
    _must_exist(spec)
    weights = check_checkpoint(checkpoint)
    if spec.named is not None:
        code = _installed(spec)
    else:
        sources = code_sources(spec.path)
        code = _named(spec, sources, _hashed(sources))
    return _identity(spec, code, [] if weights is None else _hashed(checkpoint_sources(weights)))


def own_modules(file: Path) -> list[Path]:
    """Files of the package of ``file`` that it imports, and what these import; sorted.

    They are parsed in a process of its own: an expression can be so deep that the parser ends the process.
    """
    command = [sys.executable, "-I", "-S", str(Path(imports.__file__).resolve()), str(file)]
    try:
        done = run_command(command, timeout=_PARSE_S)
        done.check_returncode()
        return [Path(name) for name in json.loads(done.stdout)]
    except (subprocess.SubprocessError, ValueError) as error:
        raise InputError(
            f"what {file} imports cannot be found out: it, or a module that it imports, cannot be parsed",
            hint=f"see why: {sys.executable} -m py_compile {file}",
            path=file,
        ) from error


def _must_exist(spec: PolicySpec) -> None:
    if not spec.path.is_file():
        raise MissingFileError(f"policy file {spec.path} does not exist", hint="check the path", path=spec.path)


def _installed(spec: PolicySpec) -> Hashes:
    _must_exist(spec)
    return [("", _sha256(path)) for path in (spec.path, *own_modules(spec.path))]


def _named(spec: PolicySpec, sources: Sources, files: Hashes) -> Hashes:
    """The files of a folder, and first which of them is the policy; no name can pass for a hash beside it."""
    policy = spec.path.relative_to(sources.root).as_posix()
    return [(f"\0{name}\0", found) for name, found in ((policy, dict(files)[policy]), *files)]


def _hashed(sources: Sources) -> Hashes:
    return [(entry.name, _sha256(entry.source)) for entry in sources.entries]


def _identity(spec: PolicySpec, code: Hashes, weights: Hashes) -> str:
    total = hashlib.sha256(spec.class_name.encode())
    for name, found in (*code, *weights):
        total.update(os.fsencode(name))
        total.update(bytes.fromhex(found))
    return total.hexdigest()


def _copied(sources: Sources, target: Path) -> Hashes:
    """Copy the files to ``target``."""
    with storage_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(target.parent).free
        if sources.size > free:
            raise StorageError(
                f"a private copy of {sources.root} needs {sources.size / 1e9:.1f} GB, and {tempfile.gettempdir()} has "
                f"{free / 1e9:.1f} GB free",
                hint="set TMPDIR to a folder with more space, and run the same command again",
                path=str(target.parent),
            )
        if sources.root.is_dir():
            target.mkdir()
        found = []
        for entry in sources.entries:
            place = target if entry.name == "." else target / entry.name
            place.parent.mkdir(parents=True, exist_ok=True)
            found.append((entry.name, _sha256(entry.source, place)))
        for place in (target.parent, target, *target.rglob("*")):
            if place.is_dir():
                place.chmod(0o755)  # whatever the user's mask is
    return found


def _sha256(source: Path, copy: Path | None = None) -> str:
    """sha256 of a regular file, hexadecimal; with ``copy``, a new file, of what is written there.

    Raises InputError for a device, a pipe or a socket, and MissingFileError for a file that is gone.
    """
    try:
        # Opening must not wait for the other end of a pipe.
        number = os.open(source, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    except FileNotFoundError as error:
        raise MissingFileError(f"{source} does not exist", hint="check the path", path=source) from error
    except OSError as error:
        raise InputError(
            f"{source} cannot be read: {error.strerror}", hint="check its type and its permissions", path=source
        ) from error
    with os.fdopen(number, "rb", buffering=0) as file:
        if not stat.S_ISREG(os.fstat(number).st_mode):
            raise InputError(f"{source} is not a regular file", hint="name a file, or a folder of files", path=source)
        if copy is None:
            return hashlib.file_digest(file, "sha256").hexdigest()
        with copy.open("xb+", buffering=0) as out:
            found = _cloned(file, out) or _written(file, out)
            os.fchmod(out.fileno(), 0o444)
    return found


def _cloned(file: FileIO, out: FileIO) -> str:
    """sha256 of a copy that shares blocks with the file until one of both is written; empty where it cannot."""
    try:
        fcntl.ioctl(out.fileno(), _FICLONE, file.fileno())
    except OSError:
        return ""
    out.seek(0)
    return hashlib.file_digest(out, "sha256").hexdigest()


def _written(file: FileIO, out: FileIO) -> str:
    total = hashlib.sha256()
    while chunk := file.read(_CHUNK):
        total.update(chunk)
        view = memoryview(chunk)
        while view:
            view = view[out.write(view) :]
    return total.hexdigest()
