"""Engines, where simulation jobs run: ``inline`` (this process), ``process`` (workers of it), ``ray`` (a cluster)."""

from __future__ import annotations

from evaluator.engines.base import (
    FINGERPRINT,
    SIMULATOR,
    BatchResult,
    Engine,
    EngineType,
    InfraError,
    Job,
    JobBatch,
    JobResult,
    StepSimulator,
    default_workers,
)
from evaluator.engines.registry import check_engine, engine_names, engine_type, make_engine, worker_count

__all__ = [
    "FINGERPRINT",
    "SIMULATOR",
    "BatchResult",
    "Engine",
    "EngineType",
    "InfraError",
    "Job",
    "JobBatch",
    "JobResult",
    "StepSimulator",
    "check_engine",
    "default_workers",
    "engine_names",
    "engine_type",
    "make_engine",
    "worker_count",
]
