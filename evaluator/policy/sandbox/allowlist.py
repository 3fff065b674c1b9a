"""Which files a policy may read and write: the Python installation, system libraries, its own folder and weights.

What must stay unseen may lie inside what must be read: the scenario lists of an installed wheel are part of the package
``rema_data``. The kernel's rules only ever add, so a folder around such a secret is not allowed itself, but entry by
entry, down to the secret.
"""

from __future__ import annotations

import glob
import os
import sys
import sysconfig
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import rema_data
from evaluator.policy.imports import outermost_folder
from rema_data.errors import MissingFileError
from rema_data.manifests import manifests_dir
from rema_data.storage import rema_home

__all__ = ["Allowed", "allowed_for", "packages_folder", "secrets"]

_SYSTEM = (
    "/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/opt", "/nix/store", "/gnu/store", "/run/opengl-driver",
    "/run/current-system", "/sys", "/proc/self", "/proc/cpuinfo", "/proc/meminfo", "/proc/stat", "/proc/loadavg",
    "/proc/version", "/proc/filesystems", "/proc/devices", "/proc/driver", "/proc/sys",
)  # fmt: skip
_ETC = (
    "ld.so.cache", "ld.so.conf", "ld.so.conf.d", "localtime", "timezone", "os-release", "nsswitch.conf", "passwd",
    "group", "OpenCL", "alternatives", "nvidia",
)  # fmt: skip
_DEVICES = (
    "/dev/null", "/dev/zero", "/dev/full", "/dev/random", "/dev/urandom", "/dev/dri", "/dev/kfd", "/dev/accel",
)  # fmt: skip
_ACCELERATORS = "/dev/nvidia*"
_FOLDER_VARIABLES = ("LD_LIBRARY_PATH", "PYTHONPATH", "CUDA_HOME", "CONDA_PREFIX", "VIRTUAL_ENV")


@dataclass(frozen=True, slots=True)
class Allowed:
    """Absolute paths; a folder stands for all that is in it."""

    read: tuple[str, ...]  # may be read, and mapped as code
    listed: tuple[str, ...]  # folders whose entries may be listed; what ``read`` names of them may be read
    devices: tuple[str, ...]  # may be read and written
    write: tuple[str, ...]  # may be read and written; entries may be made and removed


def allowed_for(
    policy: Path, checkpoint: Path | None, temporary: Path, environment: Mapping[str, str], hidden: Iterable[Path] = ()
) -> Allowed:
    """What the process of a policy needs, without ``hidden``, the scenario lists and the caches of rema.

    Library and module paths are read from the ``environment`` of the process.
    """
    survey = _Survey(frozenset(path.resolve() for path in (*secrets(), *hidden)))
    for root in (*_SYSTEM, *(f"/etc/{name}" for name in _ETC)):
        survey.add(Path(root))
    for folder in (*_python_folders(environment), outermost_folder(policy)):
        survey.add(folder)
    if checkpoint is not None:
        survey.add(checkpoint)
    devices = [path for path in (*_DEVICES, *sorted(glob.glob(_ACCELERATORS))) if os.path.exists(path)]
    return Allowed((*survey.read, str(policy)), tuple(survey.listed), tuple(devices), (str(temporary),))


def secrets() -> list[Path]:
    """What no policy may read: the scenario lists, wherever they lie, and the caches with the observations."""
    found = [Path(rema_data.__file__).parent / "_manifests", packages_folder() / "manifests", rema_home()]
    with suppress(MissingFileError):
        found.append(manifests_dir())
    return found


def packages_folder() -> Path:
    """The folder that holds the packages of this project: a checkout, or site-packages."""
    return Path(__file__).resolve().parents[3]


def _python_folders(environment: Mapping[str, str]) -> Iterator[Path]:
    yield Path(sys.executable).resolve().parent
    yield from map(Path, (sys.prefix, sys.base_prefix, sys.exec_prefix, sys.base_exec_prefix))
    yield from (Path(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib", "purelib", "platlib"))
    yield from (Path(entry) for entry in sys.path if os.path.isabs(entry))
    yield packages_folder()
    for name in _FOLDER_VARIABLES:
        yield from (Path(entry) for entry in environment.get(name, "").split(os.pathsep) if os.path.isabs(entry))


class _Survey:
    """Collects what may be read of some folders, without the resolved paths ``unseen``."""

    def __init__(self, unseen: frozenset[Path]) -> None:
        self.read: list[str] = []
        self.listed: list[str] = []
        self._unseen = unseen
        self._crowded = _crowded()
        self._done: set[Path] = set()

    def add(self, root: Path) -> None:
        """Allow a file or a folder, if it is there, without what is unseen in it."""
        with suppress(OSError):
            # /proc/self is another folder in every process: to be looked up by the one that is meant.
            place = root if root.parts[:2] == ("/", "proc") else root.resolve()
            if place.exists() and not any(secret in (place, *place.parents) for secret in self._unseen):
                self._allow(place)

    def _allow(self, place: Path) -> None:
        if place in self._done:
            return
        self._done.add(place)
        crowded = any(place in (other, *other.parents) for other in self._crowded)
        if not crowded and not any(place in secret.parents for secret in self._unseen):
            self.read.append(str(place))
            return
        self.listed.append(str(place))
        with suppress(OSError), os.scandir(place) as entries:
            for entry in entries:
                # What a link leads to is allowed in its own right or not at all.
                if entry.is_symlink() or Path(entry.path) in self._unseen or (crowded and not _is_code(entry)):
                    continue
                if entry.is_dir():
                    self._allow(Path(entry.path))
                else:
                    self.read.append(entry.path)


def _crowded() -> tuple[Path, ...]:
    """Places that hold much besides code: around them, only visible files and Python packages are allowed."""
    places = [Path(tempfile.gettempdir())]
    with suppress(RuntimeError):  # a user without a home folder
        places.append(Path.home())
    if packages_folder().name not in ("site-packages", "dist-packages"):
        places.append(packages_folder())
    return tuple(place.resolve() for place in places)


def _is_code(entry: os.DirEntry[str]) -> bool:
    if entry.is_dir():
        return os.path.isfile(os.path.join(entry.path, "__init__.py"))
    return not entry.name.startswith(".")
