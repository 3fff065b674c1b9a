"""Which files a policy may read and write: the Python installation, system libraries, its own folder and weights.

What must stay unseen may lie inside what must be read: the scenario lists of an installed wheel are part of the package
``rema_data``. The kernel's rules only ever add, so a folder around such a secret is not allowed itself, but entry by
entry, down to the secret.
"""

from __future__ import annotations

import glob
import os
import site
import sys
import sysconfig
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from rema_data.errors import MissingFileError
from rema_data.manifests import manifests_dir
from rema_data.storage import rema_home

__all__ = [
    "PACKAGES",
    "Allowed",
    "allowed_for",
    "crowded_places",
    "installation",
    "is_code",
    "packages_folder",
    "python_folders",
    "scenario_lists",
    "secrets",
]

_SYSTEM = (
    "/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/nix/store", "/gnu/store", "/run/opengl-driver",
    "/run/current-system", "/sys", "/proc/self", "/proc/cpuinfo", "/proc/meminfo", "/proc/stat", "/proc/loadavg",
    "/proc/version", "/proc/filesystems", "/proc/devices", "/proc/driver", "/proc/sys",
)  # fmt: skip
_VENDORS = ("rocm", "intel", "nvidia", "cuda", "amdgpu", "hpcx", "amazon")
"""Folders of /opt, as they begin: libraries of accelerators. What else lies there is the user's."""
_SITE_PACKAGES = ("", "lib*/python3*/*-packages", "local/lib*/python3*/*-packages", "*/lib*/python3*/*-packages",
                  "envs/*/lib*/python3*/*-packages", "python3*/*-packages")  # fmt: skip
"""Where another installation of rema may lie below a folder that can be read."""
_ETC = (
    "ld.so.cache", "ld.so.conf", "ld.so.conf.d", "localtime", "timezone", "os-release", "nsswitch.conf", "passwd",
    "group", "OpenCL", "alternatives", "nvidia",
)  # fmt: skip
_DEVICES = (
    "/dev/null", "/dev/zero", "/dev/full", "/dev/random", "/dev/urandom", "/dev/dri", "/dev/kfd", "/dev/accel",
)  # fmt: skip
_ACCELERATORS = "/dev/nvidia*"
_PACKAGES_FOLDERS = ("site-packages", "dist-packages")
PACKAGES = ("rema_data", "evaluator", "baselines")
"""The packages of this project."""
_FOLDER_VARIABLES = ("LD_LIBRARY_PATH", "PYTHONPATH", "CUDA_HOME", "CONDA_PREFIX", "VIRTUAL_ENV")


@dataclass(frozen=True, slots=True)
class Allowed:
    """Absolute paths; a folder stands for all that is in it."""

    read: tuple[str, ...]  # may be read, and mapped as code
    listed: tuple[str, ...]  # folders whose entries may be listed; what ``read`` names of them may be read
    devices: tuple[str, ...]  # may be read and written
    write: tuple[str, ...]  # may be read and written; entries may be made and removed


def allowed_for(
    policy: Iterable[Path], temporary: Path, environment: Mapping[str, str], hidden: Iterable[Path] = ()
) -> Allowed:
    """What the process of a policy needs, without ``hidden``, the scenario lists and the caches of rema.

    ``policy`` are the files and folders that it is. Library and module paths are read from the ``environment`` of the
    process.
    """
    roots = [Path(root) for root in (*_SYSTEM, *(f"/etc/{name}" for name in _ETC))]
    roots += [Path(path) for name in _VENDORS for path in sorted(glob.glob(f"/opt/{name}*"))]
    roots += python_folders(environment)
    others = {place for root in roots for place in _installations(root)}
    unseen = (*secrets(), *hidden, *(other / place for other in others for place in _LISTS))
    survey = _Survey(frozenset(path.resolve() for path in unseen), (*crowded_places(), *others))
    for root in roots:
        survey.add(root)
    devices = [path for path in (*_DEVICES, *sorted(glob.glob(_ACCELERATORS))) if os.path.exists(path)]
    own = dict.fromkeys(map(str, policy))
    return Allowed((*survey.read, *own), tuple(survey.listed), tuple(devices), (str(temporary),))


_LISTS = ("rema_data/_manifests", "manifests")
"""The scenario lists beside the packages of rema: in a wheel, and in a checkout."""


def secrets() -> list[Path]:
    """What no policy may read: the scenario lists, wherever they lie, and the caches with the observations."""
    return [*scenario_lists(), rema_home()]


def scenario_lists() -> list[Path]:
    """The folders with the scenario lists of this installation."""
    found = [packages_folder() / place for place in _LISTS]
    with suppress(MissingFileError):
        found.append(manifests_dir())
    return found


@cache
def _installations(root: Path) -> tuple[Path, ...]:
    """Folders that hold rema: ``root``, or those of Python packages below it; resolved."""
    patterns = (os.path.join(glob.escape(str(root)), place, "rema_data") for place in _SITE_PACKAGES)
    return tuple(Path(package).parent.resolve() for pattern in patterns for package in glob.glob(pattern))


def packages_folder() -> Path:
    """The folder that holds the packages of this project: a checkout, or site-packages."""
    return Path(__file__).resolve().parents[3]


def installation() -> set[Path]:
    """The folders of Python, its packages and rema, resolved."""
    named = (sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib"))
    places = (*named, sys.prefix, sys.base_prefix, sys.exec_prefix, sys.base_exec_prefix)
    found = [Path(sys.executable).resolve().parent, *map(Path, places)]
    found += [packages_folder() / name for name in PACKAGES]
    if site.ENABLE_USER_SITE:
        found.append(Path(site.getusersitepackages()))
    return {path.resolve() for path in found}


def python_folders(environment: Mapping[str, str]) -> Iterator[Path]:
    """The folders of Python and of everything that a process with this ``environment`` imports."""
    yield from sorted(installation())
    script = os.path.dirname(os.path.abspath(sys.argv[0]))  # the folder of this program is not on the policy's path
    yield from (Path(entry) for entry in sys.path if os.path.isabs(entry) and entry != script)
    yield packages_folder()
    for name in _FOLDER_VARIABLES:
        yield from (Path(entry) for entry in environment.get(name, "").split(os.pathsep) if os.path.isabs(entry))


class _Survey:
    """Collects what may be read of some folders, without the resolved paths ``unseen``."""

    def __init__(self, unseen: frozenset[Path], crowded: tuple[Path, ...]) -> None:
        self.read: list[str] = []
        self.listed: list[str] = []
        self._unseen = unseen
        self._around_unseen = {parent for secret in unseen for parent in secret.parents}
        found = [place for place in crowded if place.name not in _PACKAGES_FOLDERS]
        self._crowded = {place for other in found for place in (other, *other.parents)}
        self._done: set[Path] = set()

    def add(self, root: Path) -> None:
        """Allow a file or a folder, if it is there, without what is unseen in it."""
        with suppress(OSError):
            # /proc/self is another folder in every process: to be looked up by the one that is meant.
            place = root if root.parts[:2] == ("/", "proc") else root.resolve()
            if place.exists() and self._unseen.isdisjoint((place, *place.parents)):
                self._allow(place)

    def _allow(self, place: Path) -> None:
        if place in self._done:
            return
        self._done.add(place)
        crowded = place in self._crowded
        if not crowded and place not in self._around_unseen:
            self.read.append(str(place))
            return
        self.listed.append(str(place))
        with suppress(OSError), os.scandir(place) as entries:
            for entry in entries:
                # What a link leads to is allowed in its own right or not at all.
                if entry.is_symlink() or Path(entry.path) in self._unseen or (crowded and not is_code(entry)):
                    continue
                if entry.is_dir():
                    self._allow(Path(entry.path))
                else:
                    self.read.append(entry.path)


def crowded_places() -> tuple[Path, ...]:
    """Places that hold much besides code: around them, only visible files and Python packages are allowed."""
    places = [Path(tempfile.gettempdir())]
    with suppress(RuntimeError):  # a user without a home folder
        places.append(Path.home())
    if packages_folder().name not in _PACKAGES_FOLDERS:
        places.append(packages_folder())
    return tuple(place.resolve() for place in places)


def is_code(entry: os.DirEntry[str]) -> bool:
    """Whether an entry of a crowded folder is allowed: a visible file, or a Python package."""
    if entry.is_dir():
        return os.path.isfile(os.path.join(entry.path, "__init__.py"))
    return not entry.name.startswith(".")
