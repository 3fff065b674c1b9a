"""Which build of Bullet is installed: read from the metadata of packages, without loading any physics."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import Any

from rema_data.errors import InputError

__all__ = ["bullet_version", "decisive", "require_bullet"]

OFFICIAL, FORK = "pybullet", "pybullet-arm64"
"""Distributions of the module ``pybullet``: the fork has wheels for more platforms and versions of Python."""


def bullet_version() -> str | None:
    """Version of the installed build: ``3.2.7``, or ``pybullet-arm64-3.2.8`` of the fork; None without any."""
    for name in (OFFICIAL, FORK):
        try:
            return version(name) if name == OFFICIAL else f"{name}-{version(name)}"
        except PackageNotFoundError:
            continue
    return None


def decisive(fingerprint: Mapping[str, Any] | None) -> dict[str, Any]:
    """A fingerprint without the name of the build: what must agree for equal results.

    Builds of Bullet that give the same bits are one simulator (``benchmarks/bullet_builds.py``).
    """
    return {name: value for name, value in (fingerprint or {}).items() if name != "pybullet"}


def require_bullet() -> None:
    """Raise an InputError where ``pybullet`` is not installed, before anything starts."""
    if find_spec("pybullet") is None:
        raise InputError(
            "simulation needs PyBullet, which is not installed",
            hint=f"pip install {FORK}; platforms with wheels, and how to compile it: docs/install.md",
        )
