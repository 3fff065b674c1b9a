"""``--sandbox CMD``: a command that is put before the policy's, such as bwrap, nsjail or podman with their options."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Mapping
from pathlib import Path

from rema_data.errors import InputError

__all__ = ["PLACES", "check_sandbox", "wrapped"]

PLACES = {
    "tmp": "the policy's temporary folder, the only one that it writes",
    "policy": "the folder of the policy's file",
    "checkpoint": "its weights; the folder of its file where it has none",
    "packages": "the folder that holds rema_data, evaluator and baselines",
    "python": "the Python environment (sys.prefix)",
    "python_base": "the Python installation that it was made from (sys.base_prefix)",
    "manifests": "the scenario lists, which a policy must not see",
}
"""What may be named in braces, and what it is replaced by."""
_PLACE = re.compile(r"\{(\w+)\}")


def check_sandbox(command: str | None) -> list[str]:
    """The words of a wrapper's command; none for None. Raises InputError for a command that cannot be used."""
    if command is None:
        return []
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise InputError(
            f"--sandbox {command!r} cannot be split into words: {error}", hint="close its quotes"
        ) from error
    if not words:
        raise InputError("--sandbox names no command", hint="give one, such as: --sandbox 'bwrap ... --'")
    unknown = sorted({name for word in words for name in _PLACE.findall(word)} - set(PLACES))
    if unknown:
        known = ", ".join(f"{{{name}}}" for name in PLACES)
        raise InputError(f"--sandbox names the unknown place {{{unknown[0]}}}", hint=f"places: {known}")
    if shutil.which(words[0]) is None:
        raise InputError(f"--sandbox: there is no program {words[0]!r}", hint=f"install {words[0]}, or name its path")
    return words


def wrapped(words: list[str], places: Mapping[str, Path], command: list[str]) -> list[str]:
    """The wrapper's words with every place filled in, then ``command``."""
    return [_PLACE.sub(lambda match: str(places[match[1]]), word) for word in words] + command
