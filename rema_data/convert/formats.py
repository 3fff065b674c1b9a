"""Export formats by name: those of installed packages, and the built-in ones in the same way.

A package adds a format with an entry point in the group ``rema.formats``::

    [project.entry-points."rema.formats"]
    my-format = "my_package.my_module:MyFormat"

The object is a class without arguments that is a ``rema_data.convert.base.Format``.
"""

from __future__ import annotations

from rema_data.convert.base import Format
from rema_data.errors import InputError
from rema_data.plugins import installed, load

__all__ = ["find_format"]

_GROUP = "rema.formats"


def find_format(name: str | Format) -> Format:
    """The format of that name, or the one that is given; InputError where none is installed, or it cannot be loaded."""
    if not isinstance(name, str):
        return name
    formats = installed(_GROUP)
    if name not in formats:
        raise InputError(f"unknown format {name!r}", hint=f"installed formats: {', '.join(formats)}", format=name)
    try:
        made: Format = load(formats[name], type)()
    except InputError:
        raise
    except Exception as error:  # code of another package
        raise InputError(
            f"the format {name!r} ({formats[name].value}) cannot be used: {error}",
            hint="read its documentation, or choose another format",
            format=name,
        ) from error
    return made
