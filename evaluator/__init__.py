"""Evaluate policies on frozen scenarios, and compare the results: the Python API behind the command ``rema``.

::

    from evaluator import evaluate, compare, leaderboard

    mine = evaluate("my_policy.py", task="grasp", episodes=200)
    random = evaluate("random", task="grasp", episodes=200)
    print(mine.summary["success_rate"], compare(mine.folder, random.folder).p)
    board = leaderboard([mine.folder, random.folder])

The names below are imported when they are first used: ``import evaluator`` alone loads neither numpy nor PyBullet.
``leaderboard`` and ``replay`` are also packages: both are functions all the same.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from evaluator.api import compare, evaluate, leaderboard, read_run, replay
    from evaluator.policy.check import check_policy

__all__ = ["check_policy", "compare", "evaluate", "leaderboard", "read_run", "replay"]

_HOMES = {"check_policy": "evaluator.policy.check"} | dict.fromkeys(__all__[1:], "evaluator.api")
_PACKAGES = ("leaderboard", "replay")


class _CallablePackage(ModuleType):
    """A package that can be called like the function of the API that has its name."""

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return getattr(import_module("evaluator.api"), self.__name__.rpartition(".")[2])(*arguments, **named)


class _Evaluator(ModuleType):
    """This package: it makes ``evaluator.leaderboard`` and ``evaluator.replay`` callable when they are imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _PACKAGES and type(value) is ModuleType:
            value.__class__ = _CallablePackage
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Evaluator


def __getattr__(name: str) -> Any:
    if name in _PACKAGES:
        return import_module(f"evaluator.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module 'evaluator' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
