"""What a run is asked to do, what it reports while it runs, and what it returns."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evaluator.engines import check_engine
from evaluator.protocol import AUDIT_SHARE, MAX_BATCH, PROTOCOLS
from rema_data.errors import InputError
from rema_data.schema import check_task

if TYPE_CHECKING:
    from evaluator.policy.loading import PolicySpec
    from evaluator.runner.shards import RunShard

__all__ = ["ORDERS", "EvaluationConfig", "EvaluationResult"]

ORDERS = ("shuffled", "forward", "reverse")


@dataclass(frozen=True, slots=True)
class EvaluationConfig:
    """One evaluation.

    Attributes
    ----------
    policy : PolicySpec
    task : str
    output : Path
        Run folder; an existing one is resumed.
    checkpoint : Path or None
    device : str
        Handed to the policy.
    protocol : {"conditional", "end-to-end"}
    split : {"test", "val"}
    episodes : int
        The first so many scenarios of the list.
    engine : str
        Name of an installed engine: ``process``, ``inline``, ``ray``, ...
    workers : int or None
        Every core by default; with Ray, of the whole cluster.
    address : str or None
        Of the cluster.
    shard : RunShard or None
        Play these of the scenarios only; ``evaluator.runner.merge`` merges the shards.
    batch_size : int
        Observations in one question to the policy. Batches are fixed by scenario order, also after a resume.
    order : {"shuffled", "forward", "reverse"}
        In which order scenarios are simulated. No result depends on it; an interrupted shuffled run is unbiased.
    audit_share : float
        Share of the episodes that are repeated at the end to see whether they come out the same (some tens at least);
        0 repeats none, and the summary's ``audit`` is then null.
    sandbox : str or None
        Wrapper of the policy's process, such as bwrap: see ``evaluator.policy.sandbox.wrapper``.

    Raises
    ------
    InputError
        A value is not allowed.
    """

    policy: PolicySpec
    task: str
    output: Path
    checkpoint: Path | None = None
    device: str = "cpu"
    protocol: str = "conditional"
    split: str = "test"
    episodes: int = 10_000
    engine: str = "process"
    workers: int | None = None
    batch_size: int = 64
    order: str = "shuffled"
    audit_share: float = AUDIT_SHARE
    sandbox: str | None = None
    address: str | None = None
    shard: RunShard | None = None

    def __post_init__(self) -> None:
        check_task(self.task)
        for name, allowed in (("protocol", PROTOCOLS), ("order", ORDERS)):
            if getattr(self, name) not in allowed:
                raise InputError(
                    f"unknown {name} {getattr(self, name)!r}", hint=f"choose one of: {', '.join(allowed)}", field=name
                )
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
    """A finished run.

    Attributes
    ----------
    folder : Path
        With ``run.json``, ``episodes.parquet``, ``actions.bin``, ``leaves.bin``, ``timings.parquet``, ``summary.json``
        and ``records/``.
    summary : dict
        Content of ``summary.json``.
    """

    folder: Path
    summary: dict[str, Any]
