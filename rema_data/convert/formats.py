"""Export formats by name: the built-in ones, and those of installed packages, through one door.

A package adds a format with an entry point in the group ``rema.formats``::

    [project.entry-points."rema.formats"]
    my-format = "my_package.my_module:MyFormat"

The object is a class without arguments that is a ``rema_data.convert.base.Format``.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points

from rema_data.convert.base import Format
from rema_data.errors import InputError

__all__ = ["find_format", "installed_formats"]

_GROUP = "rema.formats"
_BUILT_IN = {"hdf5": "rema_data.convert.hdf5:Hdf5"}
"""As ``pyproject.toml`` declares them: a checkout that is not installed has them too."""


def installed_formats() -> dict[str, EntryPoint]:
    """Formats by name, not loaded yet. A package cannot replace a built-in one."""
    found = {entry.name: entry for entry in entry_points(group=_GROUP)}
    return found | {name: EntryPoint(name, place, _GROUP) for name, place in _BUILT_IN.items()}


def find_format(name: str) -> Format:
    """The format of that name.

    Raises
    ------
    InputError
        There is none, or its package cannot be loaded.
    """
    formats = installed_formats()
    if name not in formats:
        raise InputError(
            f"unknown format {name!r}", hint=f"installed formats: {', '.join(sorted(formats))}", format=name
        )
    entry = formats[name]
    try:
        made: Format = entry.load()()
    except Exception as error:  # code of another package
        package = entry.dist.name if entry.dist else "rema"
        raise InputError(
            f"the format {name!r} ({entry.value}) cannot be loaded: {error}",
            hint=f"install its package again: pip install --force-reinstall {package}",
            format=name,
        ) from error
    return made
