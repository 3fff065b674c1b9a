"""A scored run as tables and comparisons see it: what it is, its counts, and who solved which scenario."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from evaluator.policy.loading import NAME_LENGTH
from evaluator.policy.named import PRIVILEGED_KINDS, kind_of
from evaluator.protocol import PROTOCOLS
from evaluator.scenarios import SPLITS
from rema_data.errors import InputError, IntegrityError, MissingFileError
from rema_data.schema import TASKS

__all__ = ["Audit", "Counts", "FunnelStep", "Marks", "Outcomes", "ScoredRun", "acting_steps", "read_run"]

_FIELDS = ("task", "policy", "protocol", "eligible", "successes", "policy_errors", "infra_errors", "failures")
_AGAIN = "evaluate the policy again: the same command writes both files from the records"


@dataclass(frozen=True, slots=True)
class FunnelStep:
    """How many episodes reached a step (``attempted``) and passed it (``succeeded``)."""

    step: int
    attempted: int
    succeeded: int


@dataclass(frozen=True, slots=True)
class Counts:
    """The counts behind a rate.

    Attributes
    ----------
    episodes : int
        Scenarios that were to be played.
    eligible : int
        Those that were measured: the denominator.
    successes : int
    failures : dict of str -> int
        Failed episodes by label.
    policy_errors : int
        Failures without an answer: in the denominator.
    infra_errors : int
        Episodes lost to the infrastructure: in no denominator.
    funnel : tuple of FunnelStep
        Of the steps in which the policy acts.
    """

    episodes: int
    eligible: int
    successes: int
    failures: dict[str, int]
    policy_errors: int
    infra_errors: int
    funnel: tuple[FunnelStep, ...]


@dataclass(frozen=True, slots=True)
class Audit:
    """How much of a run was repeated, and how much of that came out otherwise."""

    actions: int
    action_flips: int
    outcomes: int
    outcome_flips: int


@dataclass(frozen=True, slots=True)
class Marks:
    """What two runs must share to be compared, and what tells policies apart; empty where it was not recorded.

    Attributes
    ----------
    policy_digest, protocol_hash, scenarios_hash : str
    fingerprint : dict of str -> str
        Of the simulator.
    """

    policy_digest: str = ""
    protocol_hash: str = ""
    scenarios_hash: str = ""
    fingerprint: Mapping[str, str] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Outcomes:
    """Scenario by scenario, in the order of the list.

    Attributes
    ----------
    played : bool (N,)
        The run was to play it: all, but for a shard of a run.
    eligible : bool (N,)
        Measured.
    success : bool (N,)
        False where it was not measured.
    """

    played: npt.NDArray[np.bool_]
    eligible: npt.NDArray[np.bool_]
    success: npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class ScoredRun:
    """One policy on one scenario list.

    Attributes
    ----------
    source : Path
        Run folder or entry file.
    kind : {"run", "entry"}
    policy : str
    privileged : bool
        It saw the ground truth.
    task, split, protocol : str
    counts : Counts
    marks : Marks
    stopped_early : bool
        A quick look, not a full run.
    unfinished : int
        Episodes that could have been played and have no result: 0 unless the run was cut short.
    nondeterministic : int
        Steps that had two different outcomes.
    audit : Audit or None
        None where nothing was repeated.
    outcomes : Outcomes or None
        None where only a summary is there: such a run cannot be paired.
    link : str
        Where to read about the policy; empty for run folders.
    isolation : str
        Level of the walls around the policy while it was asked; empty where it was not noted.
    """

    source: Path
    kind: Literal["run", "entry"]
    policy: str
    privileged: bool
    task: str
    split: str
    protocol: str
    counts: Counts
    marks: Marks
    stopped_early: bool = False
    unfinished: int = 0
    nondeterministic: int = 0
    audit: Audit | None = None
    outcomes: Outcomes | None = None
    link: str = ""
    isolation: str = ""

    @property
    def tag(self) -> str:
        """The kind of an installed policy, as its package says, or ``submitted``.

        A policy that saw the ground truth is always ``privileged``.
        """
        kind = kind_of(self.policy)
        return "privileged" if self.privileged or kind in PRIVILEGED_KINDS else kind or "submitted"


def acting_steps(task: str, protocol: str) -> tuple[int, ...]:
    """Steps in which the policy acts: the last one (conditional) or all (end-to-end)."""
    steps = tuple(range(len(TASKS[task])))
    return steps[-1:] if protocol == "conditional" else steps


def read_run(folder: Path) -> ScoredRun:
    """A finished run, with its outcomes if ``episodes.parquet`` is there.

    Raises
    ------
    MissingFileError
        It has no ``summary.json``.
    InputError
        That is not the summary of a run.
    IntegrityError
        ``episodes.parquet`` is damaged, or does not hold what the summary says.
    """
    path = folder / "summary.json"
    if not path.is_file():
        hint = "finish it with `rema evaluate`" if folder.is_dir() else "check the path"
        raise MissingFileError(f"{folder} holds no finished run", hint=hint, path=str(path))
    try:
        run = _from_summary(json.loads(path.read_text(encoding="utf-8")), folder)
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
        hint = "evaluate the policy again"
        raise InputError(f"{path} is not the summary of a run: {error}", hint=hint, path=str(path)) from error
    return _with_outcomes(run, folder / "episodes.parquet")


def _from_summary(summary: dict[str, Any], folder: Path) -> ScoredRun:
    missing = [field for field in _FIELDS if field not in summary]
    if missing:
        raise ValueError(f"without {', '.join(missing)}")
    if summary["task"] not in TASKS:
        raise ValueError(f"of unknown task {summary['task']!r}")
    if summary["protocol"] not in PROTOCOLS:
        raise ValueError(f"of unknown protocol {summary['protocol']!r}")
    name, split = str(summary["policy"]), str(summary.get("split", SPLITS[0]))
    if not name or len(name) > NAME_LENGTH or not name.isprintable():
        raise ValueError(f"with the policy name {name[:NAME_LENGTH]!r}")
    eligible, lost = int(summary["eligible"]), int(summary["infra_errors"])
    successes = int(summary["successes"])
    if not 0 <= successes <= eligible or lost < 0:
        raise ValueError(f"with {successes} successes of {eligible} episodes")
    return ScoredRun(
        source=folder,
        kind="run",
        policy=name,
        privileged=bool(summary.get("privileged")),
        task=summary["task"],
        split=split,
        protocol=summary["protocol"],
        counts=counts_of({"episodes": eligible + lost, **summary}),
        marks=Marks(
            policy_digest=str(summary.get("policy_digest") or ""),
            protocol_hash=str(summary.get("protocol_hash") or ""),
            scenarios_hash=str(summary.get("scenarios_hash") or ""),
            fingerprint=None if summary.get("fingerprint") is None else dict(summary["fingerprint"]),
        ),
        stopped_early=bool(summary.get("stopped_early")),
        unfinished=int(summary.get("unfinished") or 0),
        nondeterministic=int(summary.get("nondeterministic") or 0),
        audit=audit_of(summary.get("audit")),
        isolation=str(summary.get("isolation") or ""),
    )


def counts_of(summary: Mapping[str, Any]) -> Counts:
    """The counts in the content of a ``summary.json``, or of the part of it that follows from the rows."""
    return Counts(
        episodes=int(summary["episodes"]),
        eligible=int(summary["eligible"]),
        successes=int(summary["successes"]),
        failures={str(label): int(count) for label, count in sorted(summary["failures"].items())},
        policy_errors=int(summary["policy_errors"]),
        infra_errors=int(summary["infra_errors"]),
        funnel=tuple(
            FunnelStep(int(step["step"]), int(step["attempted"]), int(step["succeeded"]))
            for step in summary.get("funnel", ())
        ),
    )


def audit_of(content: Mapping[str, Any] | None) -> Audit | None:
    """The audit in the content of a ``summary.json``."""
    return None if content is None else Audit(*(int(content[field.name]) for field in dataclasses.fields(Audit)))


def _with_outcomes(run: ScoredRun, path: Path) -> ScoredRun:
    import pyarrow as pa
    import pyarrow.parquet as pq

    from evaluator.run.counts import tally
    from evaluator.run.tables import episodes_schema

    if not path.is_file():
        return run
    try:
        table = pq.read_table(path)
        schema = episodes_schema(run.task)
        for name in ("index", "success", "failure", "infra_error"):
            if table.schema.field(name).type != schema.field(name).type:
                raise ValueError(f"column {name} is {table.schema.field(name).type}, not {schema.field(name).type}")
        found = counts_of(tally(table, acting_steps(run.task, run.protocol)))
        success, numbers = table["success"].to_pylist(), table["index"].to_pylist()
    except (pa.ArrowException, KeyError, OSError, TypeError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise IntegrityError(f"{path} cannot be read: {reason}", hint=_AGAIN, path=str(path)) from error
    if not numbers or None in numbers or numbers != sorted(set(numbers)) or numbers[0] < 0:
        raise IntegrityError(f"{path} has scenarios twice or out of order", hint=_AGAIN, path=str(path))
    for field in dataclasses.fields(Counts):
        said, held = getattr(run.counts, field.name), getattr(found, field.name)
        if said != held:
            raise IntegrityError(
                f"{path} holds {field.name} {_plain(held)}, summary.json says {_plain(said)}",
                hint=_AGAIN,
                path=str(path),
                field=field.name,
                expected=said,
                got=held,
            )
    outcomes = Outcomes(*(np.zeros(numbers[-1] + 1, bool) for _ in range(3)))
    outcomes.played[numbers] = True
    outcomes.eligible[numbers] = [value is not None for value in success]
    outcomes.success[numbers] = [value is True for value in success]
    return dataclasses.replace(run, outcomes=outcomes)


def _plain(value: Any) -> Any:
    """A count as a message shows it."""
    return [f"{step.succeeded} of {step.attempted}" for step in value] if isinstance(value, tuple) else value
