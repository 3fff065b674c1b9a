"""Installed versions against those that rema asks for. Nothing is imported: the metadata of the packages are read."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from importlib import metadata

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

__all__ = ["PackageVersion", "package_versions"]

_PROJECT = "rema"


@dataclass(frozen=True, slots=True)
class PackageVersion:
    """One package, or Python itself.

    Attributes
    ----------
    name : str
    version : str or None
        None where it is not installed.
    wanted : str
        The range that rema asks for; empty for any.
    ok : bool
    """

    name: str
    version: str | None
    wanted: str
    ok: bool


def package_versions() -> tuple[PackageVersion, ...]:
    """Python, rema, and every package that rema requires."""
    try:
        about = metadata.metadata(_PROJECT)
    except metadata.PackageNotFoundError:
        return (_judged("python", platform.python_version(), ""), PackageVersion(_PROJECT, None, "", False))
    python = _judged("python", platform.python_version(), about["Requires-Python"] or "")
    needed = [Requirement(text) for text in metadata.requires(_PROJECT) or ()]
    packages = [
        _judged(item.name, _installed(item.name), str(item.specifier))
        for item in needed
        if item.marker is None or item.marker.evaluate({"extra": ""})
    ]
    return (python, PackageVersion(_PROJECT, about["Version"], "", True), *packages)


def _installed(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _judged(name: str, version: str | None, wanted: str) -> PackageVersion:
    ok = version is not None and SpecifierSet(wanted).contains(version, prereleases=True)
    return PackageVersion(name, version, wanted, ok)
