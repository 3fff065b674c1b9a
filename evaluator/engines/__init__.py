"""Engines: where simulation jobs run. ``inline`` in this process, ``process`` in supervised workers.

Read in this order: ``base`` (the contract), ``inline``, ``process``, ``child`` and ``worker`` (the two ends of a pipe).
"""

from __future__ import annotations

from evaluator.engines.base import (
    SIMULATOR,
    Engine,
    InfraError,
    Job,
    JobResult,
    Shard,
    ShardResult,
    StepSimulator,
    default_workers,
)
from rema_data.errors import InputError

__all__ = [
    "ENGINES",
    "SIMULATOR",
    "Engine",
    "InfraError",
    "Job",
    "JobResult",
    "Shard",
    "ShardResult",
    "StepSimulator",
    "default_workers",
    "make_engine",
]

ENGINES = ("process", "inline")


def make_engine(name: str, workers: int | None = None, factory: str = SIMULATOR) -> Engine:
    """An engine by name.

    Parameters
    ----------
    name : {"process", "inline"}
    workers : int, optional
        Every core by default; ``inline`` has one.
    factory : str
        ``module:attribute`` of the simulator's factory.

    Raises
    ------
    InputError
        There is no such engine, or ``workers`` is not positive.
    """
    if workers is not None and workers < 1:
        raise InputError(f"--workers {workers} is not a positive number", hint="give 1 or more", workers=workers)
    # Imported here: a worker imports this package too, and needs neither.
    if name == "inline":
        from evaluator.engines.inline import InlineEngine

        return InlineEngine(factory)
    if name == "process":
        from evaluator.engines.process import ProcessEngine

        return ProcessEngine(factory, workers)
    raise InputError(f"unknown engine {name!r}", hint=f"choose one of: {', '.join(ENGINES)}", engine=name)
