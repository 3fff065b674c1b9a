"""Engines by name: entry points of the group ``rema.engines``, the built-in ones among them."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, cast

from evaluator.engines.base import SIMULATOR, Engine, EngineType
from rema_data.errors import InputError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

__all__ = ["check_engine", "engine_names", "engine_type", "make_engine", "worker_count"]

GROUP = "rema.engines"


def _installed() -> dict[str, EntryPoint]:
    from rema_data.plugins import installed  # workers import this package, and need to start at once

    return installed(GROUP)


def engine_names() -> list[str]:
    """Names of the installed engines, in alphabetical order."""
    return list(_installed())


def engine_type(name: str) -> EngineType:
    """The class of an engine. Raises InputError where it is not installed or cannot be imported."""
    from rema_data.plugins import load

    point = _installed().get(name)
    if point is None:
        raise InputError(f"unknown engine {name!r}", hint=f"installed: {', '.join(engine_names())}", engine=name)
    return cast(EngineType, load(point, type))


def check_engine(name: str, workers: int | None = None, address: str | None = None) -> EngineType:
    """The class of an engine. Raises InputError for an unknown name, ``workers`` below 1, or an address without use."""
    found = engine_type(name)
    if workers is not None and workers < 1:
        raise InputError(f"--workers {workers} is not a positive number", hint="give 1 or more", workers=workers)
    if address is not None and found.place != "cluster":
        raise InputError(
            f"--address is for an engine on a cluster: the {name} engine runs on this machine alone",
            hint="choose another one, such as --engine ray, or drop --address",
        )
    return found


def make_engine(
    name: str, workers: int | None = None, factory: str = SIMULATOR, *, address: str | None = None
) -> Engine:
    """An engine by name; ``workers`` and ``address`` as in ``EngineType``, ``factory`` is ``module:attribute``.

    Raises InputError as ``check_engine``, or where a library that the engine needs is not installed.
    """
    return check_engine(name, workers, address)(factory, workers, address=address)


def worker_count(name: str, workers: int | None = None, *, address: str | None = None) -> int:
    """How many jobs an engine runs at a time. A cluster is asked, and left again. Raises as ``make_engine``."""
    with closing(make_engine(name, workers, address=address)) as engine:
        return engine.workers
