"""Where the frozen facts are: scenario lists, releases, checkpoints and published numbers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from rema_data import environment
from rema_data.errors import IntegrityError, MissingFileError
from rema_data.json_files import read_json
from rema_data.repair import reinstall, restore

__all__ = ["manifests_dir", "read_manifest"]

_Read = TypeVar("_Read")


def manifests_dir() -> Path:
    """Folder of the manifests: ``REMA_MANIFESTS``, else that of the checkout, else that of the installed wheel.

    Raises
    ------
    MissingFileError
        It is not a folder.
    """
    override = environment.folder_of(environment.MANIFESTS)
    package = Path(__file__).resolve().parent
    choices = [override] if override else [package / "_manifests", package.parent / "manifests"]
    for folder in choices:
        if folder.is_dir():
            return folder
    searched = ", ".join(str(folder) for folder in choices)
    missing = restore(choices[-1]) if (package.parent / ".git").exists() else reinstall()
    hint = "correct or unset REMA_MANIFESTS" if override else missing
    raise MissingFileError(f"there is no manifests folder at {searched}", hint=hint, searched=searched)


def read_manifest(path: Path, what: str, parse: Callable[[Any], _Read]) -> _Read:
    """What the JSON file ``path`` says; ``what`` is its name in messages, such as ``scenario manifest``.

    ``parse`` makes something of the content, and raises ValueError, KeyError, TypeError or AttributeError where it
    cannot.

    Raises
    ------
    MissingFileError, IntegrityError
        The file does not exist, or cannot be read.
    """
    try:
        return parse(read_json(path))
    except FileNotFoundError:
        raise MissingFileError(f"{what} {path} does not exist", hint=restore(path), path=str(path)) from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise IntegrityError(f"{what} {path} cannot be read", hint=restore(path), path=str(path)) from error
