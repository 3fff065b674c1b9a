"""Engines: where simulation jobs run: ``inline`` in this process, ``process`` in workers of it, ``ray`` in a cluster.

Read in this order: ``base`` (the contract), ``inline``, ``process``, ``child`` and ``worker`` (the two ends of a pipe),
``ray`` and ``ray_worker`` (the two ends of a cluster).
"""

from __future__ import annotations

from evaluator.engines.base import (
    FINGERPRINT,
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
    "FINGERPRINT",
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
    "worker_count",
]

ENGINES = ("process", "inline", "ray")


def make_engine(
    name: str, workers: int | None = None, factory: str = SIMULATOR, *, address: str | None = None
) -> Engine:
    """An engine by name.

    Parameters
    ----------
    name : {"process", "inline", "ray"}
    workers : int, optional
        Every core (of the cluster) by default; ``inline`` has one.
    factory : str
        ``module:attribute`` of the simulator's factory.
    address : str, optional
        Of the Ray cluster; other engines have none.

    Raises
    ------
    InputError
        There is no such engine, it takes no address, ``workers`` is not positive, or Ray is not installed.
    """
    if address is not None and name != "ray":
        raise InputError(f"the {name} engine runs on this machine alone", hint="add --engine ray, or drop --address")
    if workers is not None and workers < 1:
        raise InputError(f"--workers {workers} is not a positive number", hint="give 1 or more", workers=workers)
    # Imported here: a worker imports this package too, and needs neither.
    if name == "inline":
        from evaluator.engines.inline import InlineEngine

        return InlineEngine(factory)
    if name == "process":
        from evaluator.engines.process import ProcessEngine

        return ProcessEngine(factory, workers)
    if name == "ray":
        from evaluator.engines.ray import RayEngine

        # Outcomes of another build must not enter a run: every machine answers for its simulator first.
        return RayEngine(factory, workers, address=address, same=FINGERPRINT if factory == SIMULATOR else None)
    raise InputError(f"unknown engine {name!r}", hint=f"choose one of: {', '.join(ENGINES)}", engine=name)


def worker_count(name: str, workers: int | None = None, *, address: str | None = None) -> int:
    """How many simulators an engine runs at a time.

    Parameters
    ----------
    name, workers, address
        As in ``make_engine``. A Ray cluster is asked where ``workers`` is not given, and then stays connected.

    Raises
    ------
    InputError
        As ``make_engine``; or there is no cluster at the address.
    """
    if name == "inline":
        return 1
    if workers is not None:
        return workers
    if name == "process":
        return default_workers()
    engine = make_engine(name, address=address)
    return int(engine.workers)  # type: ignore[attr-defined]
