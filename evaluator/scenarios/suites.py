"""The suites of this installation, and the cells of their lists; see ``suite`` for what a suite is."""

from __future__ import annotations

import json
from typing import NamedTuple

from evaluator.scenarios.axes import AXES
from evaluator.scenarios.lists import VERSION, ScenarioList, installed_list, manifest_path, versions
from rema_data.errors import InputError, IntegrityError

__all__ = ["SUITE", "Cell", "cells", "cells_of", "check_suite", "suite_length", "suites"]

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


def check_suite(name: str) -> str:
    """The name of a suite; InputError where there is no such one."""
    here = suites()
    if name not in here:
        hint = f"choose one of: {', '.join(here) or 'none is here'}"
        raise InputError(f"there is no suite {name!r}", hint=hint, suite=name)
    return name


def suite_length(suite: str, task: str, split: str) -> int:
    """Number of scenarios of a suite in a task; InputError where there is no such suite, or it has no such list."""
    found = installed_list(task, split, check_suite(suite))
    if found is None:
        raise InputError(f"the suite {suite} has no {split} list of {task}", hint="choose another task or split")
    return found[1]


class Cell(NamedTuple):
    """One axis at one level, in one task."""

    task: str
    axis: str
    level: int


def cells(task: str) -> list[Cell]:
    """The cells of a task, axis after axis."""
    return [Cell(task, axis.name, level) for axis in AXES.values() for level in axis.levels_in(task)]


def cells_of(listed: ScenarioList) -> dict[Cell, list[int]]:
    """The indices of the scenarios of every cell of a suite's list, none of a clean list.

    IntegrityError for an axis that is not known here.
    """
    found: dict[Cell, list[int]] = {}
    for scenario in listed.scenarios:
        if scenario.variation is not None:
            key = Cell(listed.task, scenario.variation.axis, scenario.variation.level)
            if key.axis not in AXES:
                raise IntegrityError(
                    f"the {listed.task} list of {listed.version} has an axis that is not known here: {key.axis!r:.80}",
                    hint="install the version of rema that the suite belongs to",
                    axis=key.axis,
                )
            found.setdefault(key, []).append(scenario.index)
    return dict(sorted(found.items(), key=lambda item: (AXES[item[0].axis].number, item[0].level)))
