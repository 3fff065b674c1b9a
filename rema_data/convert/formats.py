"""Every format by its name on the command line."""

from __future__ import annotations

from rema_data.convert.base import Format
from rema_data.convert.hdf5 import Hdf5
from rema_data.errors import InputError

__all__ = ["FORMATS", "find_format"]

FORMATS: dict[str, Format] = {"hdf5": Hdf5()}


def find_format(name: str) -> Format:
    """The format of that name.

    Raises
    ------
    InputError
        There is none.
    """
    if name not in FORMATS:
        raise InputError(f"unknown format {name!r}", hint=f"choose one of: {', '.join(FORMATS)}", format=name)
    return FORMATS[name]
