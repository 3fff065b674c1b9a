"""How far a policy is kept from the judge: which walls are up, and the level that they add up to.

::

    L1   a process of its own: clean environment, limits, deadlines, killed by group
    L2   and the kernel denies it files, network, other processes, signals
    L3   and a wrapper (bwrap, nsjail, podman) gave it namespaces of its own

A level is a list of what was tried and found closed, not a promise: see ``docs/threat_model.md``.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["Isolation", "Wall", "isolation_of"]

KERNEL_WALLS = ("files", "network", "processes", "signals", "inspection")
"""All of them make L2."""
NAMESPACES = ("mnt", "net", "pid")
"""All of them, besides the kernel's walls, make L3."""


@dataclass(frozen=True, slots=True)
class Wall:
    """One thing that a policy is kept from.

    Attributes
    ----------
    name : str
    up : bool
        Whether it was tried, after the wall was put up, and denied.
    detail : str
        By what; or why the wall is down.
    """

    name: str
    up: bool
    detail: str


@dataclass(frozen=True, slots=True)
class Isolation:
    """The walls around a policy.

    Attributes
    ----------
    level : {"L1", "L2", "L3"}
    walls : tuple of Wall
    sandbox : str or None
        The wrapper's command, as the user gave it.
    """

    level: str
    walls: tuple[Wall, ...]
    sandbox: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain values, ready for JSON: ``level``, ``up`` and ``down`` (wall -> detail), ``sandbox``."""
        return {
            "level": self.level,
            "up": {wall.name: wall.detail for wall in self.walls if wall.up},
            "down": {wall.name: wall.detail for wall in self.walls if not wall.up},
            "sandbox": self.sandbox,
        }

    def __str__(self) -> str:
        """One line for a terminal."""
        up = ", ".join(wall.name for wall in self.walls if wall.up)
        down = "; ".join(f"{wall.name} ({wall.detail})" for wall in self.walls if not wall.up)
        return f"{self.level}, walls up: {up}" + (f"; down: {down}" if down else "")


def isolation_of(report: Mapping[str, Any], sandbox: str | None = None) -> Isolation:
    """The level that a policy's process reached.

    Parameters
    ----------
    report : mapping
        What the process said before it read anything of the policy: ``walls`` (name, up, detail of each) and
        ``namespaces`` (kind -> identity).
    sandbox : str or None
        The wrapper's command.
    """
    walls = [Wall("process", True, "own process, session, environment and temporary folder")]
    walls += [Wall(str(name), up is True, str(detail)) for name, up, detail in report["walls"]]
    walls.append(_namespaces(report["namespaces"], sandbox))
    up = {wall.name for wall in walls if wall.up}
    level = "L1" if not up.issuperset(KERNEL_WALLS) else "L3" if "namespaces" in up else "L2"
    return Isolation(level, tuple(walls), sandbox)


def _namespaces(found: Mapping[str, str], sandbox: str | None) -> Wall:
    """Whether the process sees other files, networks and processes than the judge, whatever the wrapper is called."""
    if sandbox is None:
        return Wall("namespaces", False, "no wrapper (--sandbox)")
    shared = [kind for kind in NAMESPACES if kind not in found or found[kind] == _own_namespace(kind)]
    if shared:
        return Wall("namespaces", False, f"the wrapper shares with the judge: {', '.join(shared)}")
    return Wall("namespaces", True, ", ".join(NAMESPACES))


def _own_namespace(kind: str) -> str | None:
    try:
        return os.readlink(f"/proc/self/ns/{kind}")
    except OSError:
        return None
