"""Policies that packages offer by name, through entry points in the group ``rema.policies``.

An entry point names a ``NamedPolicy`` in a light module: it is imported to list and to find policies, and the policy's
own code is not.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rema_data import plugins
from rema_data.errors import InputError

__all__ = ["GROUP", "KINDS", "PRIVILEGED_KINDS", "NamedPolicy", "find_named", "is_adapted", "kind_of", "policy_names"]

GROUP = "rema.policies"
"""The entry points that name policies."""
KINDS = ("learned", "heuristic", "privileged", "random", "reference", "simulator")
"""What a named policy may be; a policy without a name is ``submitted``."""
PRIVILEGED_KINDS = ("privileged", "reference")
"""Kinds that see the ground truth."""


@dataclass(frozen=True, slots=True)
class NamedPolicy:
    """A policy that a package offers by name. Raises InputError for an unknown kind."""

    file: Path  # its Python file, absolute; it imports its own package by absolute imports
    class_name: str
    # one of ``KINDS``: shown on the leaderboard. ``privileged`` sees the ground truth; ``reference`` does too, and
    # prepares scenarios; ``simulator`` carries a simulator or the scenario list
    kind: str
    description: str  # one line
    checkpoint: Path | None = None  # weights that its package carries, for a run that names none
    published: str = ""  # row of the paper's Table 2 that it reimplements; empty for most
    adapted: bool = False  # its weights were trained on changed situations, as those of a generalisation suite are

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"unknown kind of policy {self.kind!r}", hint=f"choose one of: {', '.join(KINDS)}")


def policy_names() -> list[str]:
    """Names of the installed policies, sorted."""
    return list(plugins.installed(GROUP))


def find_named(name: str) -> NamedPolicy | None:
    """The installed policy of that name, or None. InputError where the package that offers it is broken."""
    point = plugins.installed(GROUP).get(name)
    return None if point is None else plugins.load(point, NamedPolicy)


def kind_of(name: str) -> str | None:
    """Kind of the installed policy of that name; None where there is none, or its package is broken."""
    try:
        named = find_named(name)
    except InputError:
        return None
    return None if named is None else named.kind


def is_adapted(name: str) -> bool:
    """Whether the installed policy of that name was trained on changed situations; False where there is none."""
    try:
        named = find_named(name)
    except InputError:
        return False
    return named is not None and named.adapted


def is_reserved(name: str) -> bool:
    """Whether a submitted policy may not have this name: an installed one has it, or a learned one's name begins it."""
    return name in policy_names() or kind_of(name.partition("-")[0]) == "learned"


def listing() -> str:
    """The installed policies, a line each."""
    names = policy_names()
    width = max(map(len, names), default=0)
    lines = []
    for name in names:
        try:
            named = find_named(name)
            about = "" if named is None else f"{named.description} ({named.kind})"
        except InputError as error:
            about = f"broken: {error.message}"
        lines.append(f"  {name:{width}}  {about}")
    return "\n".join(lines)
