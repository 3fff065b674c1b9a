"""The machine: installed versions, the home folder, and how many training samples a second it reads."""

from __future__ import annotations

import os
import platform
import shutil
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata
from typing import TYPE_CHECKING

import numpy as np
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from rema_data.storage import rema_home

if TYPE_CHECKING:
    from rema_data.loader.dataset import Delivery
    from rema_data.loader.release import Release

__all__ = ["BATCH_SIZES", "Home", "PackageVersion", "Speed", "home", "measure_speed", "package_versions"]

BATCH_SIZES = (8, 256)
"""The paper's batch, and a large one."""
_PROJECT = "rema"


@dataclass(frozen=True, slots=True)
class PackageVersion:
    """One package, or Python itself."""

    name: str
    version: str | None  # None where it is not installed
    wanted: str  # the range that rema asks for; empty for any
    ok: bool


def package_versions() -> tuple[PackageVersion, ...]:
    """Python, rema, and every package that rema requires; none is imported."""
    try:
        about = metadata.metadata(_PROJECT)
    except metadata.PackageNotFoundError:
        return (_compare("python", "", platform.python_version()), PackageVersion(_PROJECT, None, "", False))
    python = _compare("python", about["Requires-Python"] or "", platform.python_version())
    needed = [Requirement(text) for text in metadata.requires(_PROJECT) or ()]
    packages = [
        _compare(item.name, str(item.specifier))
        for item in needed
        if item.marker is None or item.marker.evaluate({"extra": ""})
    ]
    return (python, PackageVersion(_PROJECT, about["Version"], "", True), *packages)


def _compare(name: str, wanted: str, version: str | None = None) -> PackageVersion:
    """A version, by default the installed one of the package ``name``, against a range."""
    if version is None:
        with suppress(metadata.PackageNotFoundError):
            version = metadata.version(name)
    ok = version is not None and SpecifierSet(wanted).contains(version, prereleases=True)
    return PackageVersion(name, version, wanted, ok)


@dataclass(frozen=True, slots=True)
class Home:
    """The folder of everything that can be fetched or built again."""

    path: str
    writable: bool  # files can be created there
    free_bytes: int  # on its disk


def home() -> Home:
    """The state of ``REMA_HOME``."""
    path = rema_home()
    there = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
    return Home(str(path), there.is_dir() and os.access(there, os.W_OK | os.X_OK), shutil.disk_usage(there).free)


@dataclass(frozen=True, slots=True)
class Speed:
    """Random reads by one process."""

    delivery: str  # quantised or float32
    batch_size: int
    samples_per_s: float


def measure_speed(release: Release, seconds: float = 1.0) -> Iterator[Speed]:
    """Read random batches for about ``seconds`` in each delivery and size of batch; raises as ``Release.cache``."""
    deliveries: tuple[Delivery, ...] = ("quantised", "float32")
    rng = np.random.default_rng(0)
    for delivery in deliveries:
        dataset = release.steps(which="all", maps=delivery)
        for size in BATCH_SIZES:
            dataset[rng.integers(len(dataset), size=size)]  # opens the files
            read, began = 0, time.perf_counter()
            while (passed := time.perf_counter() - began) < seconds or not read:
                dataset[rng.integers(len(dataset), size=size)]
                read += size
            yield Speed(delivery, size, read / passed)
