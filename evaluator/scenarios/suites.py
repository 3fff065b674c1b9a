"""The suites of this installation: which there are, and how long their lists are."""

from __future__ import annotations

import json

from evaluator.scenarios.lists import VERSION, installed_list, manifest_path, versions
from rema_data.errors import InputError

__all__ = ["SUITE", "suite_length", "suites"]

SUITE = "suite"
"""The field of a manifest that says that its lists are those of a suite."""


def suites() -> tuple[str, ...]:
    """Names of the suites that are here."""
    return tuple(name for name in versions() if name != VERSION and _is_suite(name))


def _is_suite(version: str) -> bool:
    try:
        return SUITE in json.loads(manifest_path(version).read_bytes())
    except (ValueError, OSError, TypeError):
        return False


def suite_length(suite: str, task: str, split: str) -> int:
    """Number of scenarios of a suite in a task; InputError where there is no such suite, or it has no such list."""
    if suite not in suites():
        raise InputError(
            f"there is no suite {suite!r}", hint=f"choose one of: {', '.join(suites()) or 'none is here'}", suite=suite
        )
    found = installed_list(task, split, suite)
    if found is None:
        raise InputError(f"the suite {suite} has no {split} list of {task}", hint="choose another task or split")
    return found[1]
