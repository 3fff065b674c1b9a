"""Which build of Bullet is installed: read from the metadata of packages, without loading any physics."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

from rema_data.errors import InputError

__all__ = ["bullet_version", "require_bullet", "same_simulator"]

OFFICIAL, FORK = "pybullet", "pybullet-arm64"
"""Distributions that provide the module ``pybullet``: both build the same Bullet, the fork for more platforms."""


def bullet_version() -> str | None:
    """Version of the installed build: ``3.2.7``, or ``pybullet-arm64-3.2.8`` of the fork; None where neither is."""
    for name in (OFFICIAL, FORK):
        try:
            return version(name) if name == OFFICIAL else f"{name}-{version(name)}"
        except PackageNotFoundError:
            continue
    return None


def require_bullet() -> None:
    """Check that simulation is possible here.

    Raises
    ------
    InputError
        The module ``pybullet`` is not installed.
    """
    if find_spec("pybullet") is None:
        raise InputError(
            "simulation needs PyBullet, which is not installed",
            hint=f"pip install {FORK}; without a wheel for this platform this needs a C++ compiler: docs/install.md",
        )


def same_simulator(a: Mapping[str, str] | None, b: Mapping[str, str] | None) -> bool:
    """Whether two fingerprints are of simulators that agree bit for bit.

    Constants and the outcomes of the probe decide. The name of the build does not: two builds of the same source
    that compute the same bits are one simulator (``benchmarks/bullet_builds.py``).
    """
    first, second = ({k: v for k, v in (mark or {}).items() if k != "pybullet"} for mark in (a, b))
    return first == second
