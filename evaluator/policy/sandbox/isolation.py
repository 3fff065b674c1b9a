"""The isolation level of a policy, and the restrictions that it follows from.

::

    L1   a separate process: clean environment, limits, deadlines, killed by group
    L2   and Landlock and seccomp deny it files, network, other processes, signals
    L3   and a wrapper (bwrap, nsjail, podman) gave it separate namespaces

A level lists what was tried and denied; it is not a guarantee: see ``docs/threat_model.md``.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

__all__ = ["Isolation", "Restriction", "isolation_of"]

KERNEL_RESTRICTIONS = (
    "files", "network", "processes", "signals", "inspection", "privileges", "clock", "scheduling", "attributes",
    "queues", "supervision",
)  # fmt: skip
"""All of them make L2."""
NAMESPACES = ("mnt", "net", "pid")
"""All of them, besides the restrictions of the kernel, make L3."""


@dataclass(frozen=True, slots=True)
class Restriction:
    """One thing that the sandbox denies or limits."""

    name: str
    active: bool  # whether it was tried in the sandbox, and denied
    detail: str  # by what; or why it is not denied


@dataclass(frozen=True, slots=True)
class Isolation:
    """What the sandbox of a policy restricts."""

    level: str  # L1, L2 or L3
    restrictions: tuple[Restriction, ...]
    sandbox: str | None = None  # the wrapper's command, as the user gave it

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON: ``level``, ``sandbox``, and the active (``up``) and the other (``down``) restrictions."""
        return {
            "level": self.level,
            "up": {one.name: one.detail for one in self.restrictions if one.active},
            "down": {one.name: one.detail for one in self.restrictions if not one.active},
            "sandbox": self.sandbox,
        }

    def __str__(self) -> str:
        """One line for a terminal."""
        if self.level == "L1":
            missing = "; ".join(f"{one.name}: {one.detail}" for one in self.restrictions if not one.active)
            return f"L1 (a separate process only; not restricted: {missing})"
        if self.level == "L3":
            return "L3 (Landlock + seccomp, own namespaces)"
        hint = "`--sandbox bwrap` for L3" if self.sandbox is None else self.restrictions[-1].detail
        return f"L2 (Landlock + seccomp); {hint}"


def isolation_of(report: Mapping[str, Any], sandbox: str | None = None) -> Isolation:
    """The level that a policy's process reached.

    It reported ``restrictions`` (name, active, detail) and ``namespaces`` (kind -> identity) before it read anything of
    the policy. ``sandbox`` is the wrapper's command.
    """
    found = [Restriction("process", True, "own process, session, environment and temporary folder")]
    found += [Restriction(str(name), active is True, str(detail)) for name, active, detail in report["restrictions"]]
    found.append(_namespaces(report["namespaces"], sandbox))
    active = {one.name for one in found if one.active}
    level = "L1" if not active.issuperset(KERNEL_RESTRICTIONS) else "L3" if "namespaces" in active else "L2"
    return Isolation(level, tuple(found), sandbox)


def _namespaces(found: Mapping[str, str], sandbox: str | None) -> Restriction:
    """Whether the process sees other files, networks and processes than the evaluator does, for any wrapper."""
    if sandbox is None:
        return Restriction("namespaces", False, "no wrapper (--sandbox)")
    own = {}
    for kind in NAMESPACES:
        with suppress(OSError):
            own[kind] = os.readlink(f"/proc/self/ns/{kind}")
    shared = [kind for kind in NAMESPACES if kind not in found or found[kind] == own.get(kind)]
    if shared:
        return Restriction("namespaces", False, f"the wrapper shares with the evaluator: {', '.join(shared)}")
    return Restriction("namespaces", True, ", ".join(NAMESPACES))
