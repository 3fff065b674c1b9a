"""The configuration and the result of a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evaluator.engines import check_engine
from evaluator.protocol import AUDIT_SHARE, MAX_BATCH, SCENARIOS, check_protocol
from rema_data.errors import InputError
from rema_data.schema import check_task

if TYPE_CHECKING:
    from evaluator.policy.loading import PolicySpec
    from evaluator.runner.shards import RunShard

__all__ = ["ORDERS", "EvaluationConfig", "EvaluationResult"]

ORDERS = ("shuffled", "forward", "reverse")


@dataclass(frozen=True, slots=True)
class EvaluationConfig:
    """One evaluation: the arguments of ``evaluator.evaluate``, resolved; an InputError where a value is not allowed."""

    policy: PolicySpec
    task: str
    output: Path  # run folder; an existing one is resumed
    checkpoint: Path | None = None
    device: str = "cpu"
    protocol: str = "conditional"
    split: str = "test"
    version: str | None = None  # of the scenario lists: a suite or a fresh list in place of the ones in force
    episodes: int = SCENARIOS["test"]
    engine: str = "process"
    workers: int | None = None
    batch_size: int = 64  # batches are fixed by scenario order, also after a resume
    # of simulation: shuffled, forward or reverse. No result depends on it; an interrupted shuffled run is unbiased
    order: str = "shuffled"
    # share of the episodes that is repeated at the end (``AUDIT_LEAST`` at least); 0 repeats none
    audit_share: float = AUDIT_SHARE
    sandbox: str | None = None
    address: str | None = None
    shard: RunShard | None = None

    def __post_init__(self) -> None:
        check_task(self.task)
        check_protocol(self.protocol)
        if self.order not in ORDERS:
            raise InputError(f"unknown order {self.order!r}", hint=f"choose one of: {', '.join(ORDERS)}", field="order")
        check_engine(self.engine, self.workers, self.address)
        for name in ("episodes", "batch_size"):
            value = getattr(self, name)
            if value < 1:
                flag = name.replace("_", "-")
                raise InputError(f"--{flag} {value} is not a positive number", hint="give 1 or more", field=name)
        if not 0 <= self.audit_share <= 1:
            raise InputError(f"audit_share {self.audit_share} is not a share", hint="give 0 to 1", field="audit_share")
        if self.batch_size > MAX_BATCH:
            raise InputError(f"--batch-size {self.batch_size} is too large", hint=f"give {MAX_BATCH} or less")
        if self.shard is not None:
            self.shard.indices(self.episodes, self.batch_size)


@dataclass(frozen=True, slots=True)
class EvaluationResult:
    """A finished run: its ``folder``, and the content of its ``summary.json``."""

    folder: Path
    summary: dict[str, Any]
