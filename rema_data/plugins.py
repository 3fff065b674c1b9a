"""What installed packages offer through entry points: policies, engines, formats. The built-in ones come the same way.

A package offers something with a line in its ``pyproject.toml``::

    [project.entry-points."rema.policies"]
    my-policy = "my_package.catalogue:MY_POLICY"
"""

from __future__ import annotations

import sys
import tomllib
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TypeVar

from rema_data.errors import InputError

__all__ = ["installed", "load"]

_T = TypeVar("_T")
_CHECKOUT = Path(__file__).resolve().parents[1] / "pyproject.toml"


def installed(group: str) -> dict[str, EntryPoint]:
    """Entry points of a group by name, in alphabetical order; nothing is imported.

    Raises InputError where two packages offer different things under one name.
    """
    return dict(_installed(group, tuple(sys.path)))


@cache
def _installed(group: str, _path: tuple[str, ...]) -> dict[str, EntryPoint]:
    found: dict[str, EntryPoint] = {}
    for point in entry_points(group=group):
        other = found.setdefault(point.name, point)
        if other.value != point.value:
            raise InputError(
                f"two packages offer {point.name!r} as one of {group}: {_package(other)} and {_package(point)}",
                hint=f"uninstall one of them: pip uninstall {_package(point)}",
                name=point.name,
            )
    if _CHECKOUT.is_file():  # which may not be installed, or have grown since
        own = tomllib.loads(_CHECKOUT.read_text(encoding="utf-8"))["project"].get("entry-points", {}).get(group, {})
        for name, value in own.items():
            found.setdefault(name, EntryPoint(name, value, group))
    return dict(sorted(found.items()))


def load(point: EntryPoint, kind: type[_T]) -> _T:
    """The object of an entry point; raises InputError where it cannot be imported, or is not a ``kind``."""
    where = f"{point.name!r} of {point.group} ({point.value}, package {_package(point)})"
    hint = f"reinstall or uninstall that package: pip uninstall {_package(point)}"
    try:
        found = point.load()
    except Exception as error:  # code of another package: it may raise anything
        raise InputError(f"{where} cannot be loaded: {type(error).__name__}: {error}", hint=hint) from error
    if not isinstance(found, kind):
        raise InputError(f"{where} is a {type(found).__name__}, not a {kind.__name__}", hint=hint)
    return found


def _package(point: EntryPoint) -> str:
    return "rema" if point.dist is None else point.dist.name
