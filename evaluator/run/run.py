"""One run, from its folder or its entry: what tables, comparisons, pages and replays read."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import pyarrow as pa

from evaluator.policy.named import PRIVILEGED_KINDS, kind_of
from evaluator.protocol import acting_steps
from evaluator.run.actions import Actions
from evaluator.run.audit import Audit
from evaluator.run.check import Finding, RunFiles
from evaluator.run.counts import Counts
from evaluator.run.derived import Derived, Outcomes
from evaluator.run.folder import TIMINGS_FILE
from evaluator.run.records import ANSWERS, read_journal
from evaluator.run.seal import results_name
from evaluator.run.tables import TIMINGS_SCHEMA, first_line
from evaluator.scenarios.lists import FRESH, version_of
from evaluator.scenarios.strata import Targets, targets_of_list
from evaluator.scenarios.suites import suites
from rema_data.bounded import parquet_table
from rema_data.errors import InputError, IntegrityError, MissingFileError

__all__ = ["AGAIN", "COMPARABLE", "Provenance", "Row", "Run"]

AGAIN = "run the same `rema evaluate` again: it writes the tables from its records"
COMPARABLE = ("task", "split", "protocol", "protocol_hash", "scenarios_hash")
"""What two runs must share to be compared scenario by scenario."""
_FINDINGS_NAMED = 3

Row = Mapping[str, Any]
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Provenance:
    """What was evaluated, by which rules, on what, and with what."""

    policy_digest: str
    protocol_hash: str  # two runs compare where this and ``scenarios_hash`` agree
    scenarios_hash: str
    fingerprint: Mapping[str, str]  # of the simulator; where it differs, two runs may differ because of it
    # versions, commit, machine and engine, as plain values, for people
    environment: Mapping[str, Any] = field(default_factory=dict)
    seal: str = ""  # of the run folder; empty where it has none


@dataclass(frozen=True, eq=False, kw_only=True)
class Run:
    """One policy on one scenario list. ``evaluator.read_run`` makes it.

    An entry of format 2 holds actions and no result: it has counts and outcomes once they were derived from these
    (``evaluator.leaderboard.verification``).
    """

    source: Path  # run folder or entry
    policy: str
    privileged: bool  # the policy saw the ground truth
    task: str
    split: str
    protocol: str
    provenance: Provenance
    audit: Audit | None  # None where nothing was repeated
    stopped_early: bool = False  # a quick run, not a full one
    unfinished: int = 0  # episodes without a result though they could be played: 0 unless interrupted
    nondeterministic: int = 0  # steps that had two different outcomes
    isolation: str = ""  # lowest level of the policy's sandbox; empty where it was not recorded
    link: str = ""  # where to read about the policy; empty for run folders
    # what an entry, or the class of the policy, says it is; empty for other run folders and entries of format 1
    kind_of_policy: str = ""
    # trained on situations that were changed as those of a suite are: ranked apart in a suite
    adapted: bool = False
    digest: str = ""  # sha256 of an entry
    # how it is known that the actions give these outcomes: ``here`` (simulated on this machine) or ``record`` (one that
    # comes with rema); empty where nobody knows
    verified: str = ""
    doubt: str = ""  # why it is not, where its actions were simulated
    findings: tuple[Finding, ...] = ()  # what changed since the seal or contradicts; empty unless the reader asked
    files: RunFiles | None = None  # content of the run folder; None for an entry
    recorded: Actions | None = None  # the action log of an entry of format 2
    packed: tuple[Counts, Outcomes] | None = None  # of an entry, in place of a table; None for a folder

    @property
    def kind(self) -> Literal["run", "entry"]:
        """What it was read from: a run folder, or an entry."""
        return "entry" if self.files is None else "run"

    @property
    def seal_state(self) -> Literal["whole", "changed", "unsealed"]:
        """Whether something changed since the run was sealed; ``findings`` name it."""
        if self.findings:
            return "changed"
        return "whole" if self.files is None or self.files.sealed else "unsealed"

    @property
    def same_policy(self) -> tuple[str, str, str]:
        """What is equal in runs of one policy in one task: the task, its name, and its digest (or where it is)."""
        return self.task, self.policy, self.provenance.policy_digest or str(self.source)

    @property
    def tag(self) -> str:
        """The kind of an installed policy, or ``submitted``; always ``privileged`` if it saw the ground truth."""
        kind = self.kind_of_policy or kind_of(self.policy)
        return "privileged" if self.privileged or kind in PRIVILEGED_KINDS else kind or "submitted"

    @property
    def honest(self) -> bool:
        """Whether the policy had nothing but the observations: only then it has a rank."""
        return self.tag not in ("privileged", "simulator")

    @property
    def actions(self) -> Actions:
        """The action log, uint16 (episodes, steps); an InputError for an entry of format 1, which has none."""
        if self.recorded is not None:
            return self.recorded
        return self._read(self.folder.actions)

    @property
    def has_actions(self) -> bool:
        """Whether there is an action log, from which outcomes can be derived."""
        return self.recorded is not None or (self.files is not None and self.files.actions is not None)

    def derived(self, found: Derived, verified: str) -> Run:
        """The entry with what its actions give."""
        provenance = dataclasses.replace(self.provenance, fingerprint=found.fingerprint)
        return dataclasses.replace(
            self, provenance=provenance, verified=verified, packed=(found.counts, found.outcomes)
        )

    @property
    def comparable(self) -> dict[str, str]:
        """The values of ``COMPARABLE``."""
        return {name: getattr(self.provenance if name.endswith("_hash") else self, name) for name in COMPARABLE}

    @property
    def steps(self) -> tuple[int, ...]:
        """Steps in which the policy acted, ascending."""
        return acting_steps(self.task, self.protocol)

    @property
    def end_to_end(self) -> bool:
        """Whether the policy did every step."""
        return self.protocol == "end-to-end"

    @cached_property
    def version(self) -> str:
        """The version of its scenario list; empty where the list is not here."""
        try:
            return version_of(self.task, self.split, self.provenance.scenarios_hash)
        except MissingFileError:  # there are no lists at all
            return ""

    @cached_property
    def suite(self) -> str:
        """The generalisation suite that it was played over; empty for clean scenarios, and lists that are not here."""
        return self.version if self.version and self.version in suites() else ""

    @property
    def setting(self) -> str:
        """The suite that it was played over, or its protocol: a part of the name of its entry."""
        return self.suite or self.protocol

    @property
    def fresh(self) -> bool:
        """Whether its scenarios were drawn from a seed on this machine."""
        return self.version.startswith(FRESH)

    @property
    def counts(self) -> Counts:
        """Counts, rate and interval, from the rows.

        An IntegrityError where the table cannot be read (only if the reader asked for findings); so with the properties
        below.
        """
        return self._read(self.folder.counts) if self.packed is None else self.packed[0]

    @property
    def has_counts(self) -> bool:
        """Whether there are counts: not for an entry of format 2 until they were derived."""
        return self.packed is not None or self.files is not None

    @cached_property
    def outcomes(self) -> Outcomes:
        """Which scenario was measured, and solved."""
        if self.packed is not None:
            return self.packed[1]
        success = self.table["success"].to_pylist()
        return Outcomes(np.array([one is not None for one in success]), np.array([one is True for one in success]))

    @property
    def folder(self) -> RunFiles:
        """The files of the run folder; an InputError for an entry, so with the properties below."""
        if self.files is None:
            raise self.no_folder()
        return self.files

    def _read(self, content: _T | None) -> _T:
        if content is None:
            raise self.refusal()
        return content

    @property
    def header(self) -> Mapping[str, Any]:
        """Content of ``run.json``."""
        return self.folder.header

    @property
    def summary(self) -> Mapping[str, Any]:
        """Content of ``summary.json``."""
        return self._read(self.folder.summary)

    @property
    def table(self) -> pa.Table:
        """The results table: a row for each scenario, in their order."""
        return self._read(self.folder.table)

    @property
    def stored(self) -> pa.Table:
        """The same without the columns that are newer than the run."""
        return self._read(self.folder.stored)

    @cached_property
    def rows(self) -> Sequence[Row]:
        """Rows of the results table; a null is None."""
        return self.table.to_pylist()  # type: ignore[no-any-return]

    @property
    def measured(self) -> list[Row]:
        """Rows of the eligible episodes: those with an outcome."""
        return [row for row in self.rows if row["success"] is not None]

    @property
    def targets(self) -> Targets:
        """The objects that the last step is about, scenario by scenario, and the cells of a suite."""
        if self.suite:
            return targets_of_list(self.task, self.split, self.suite).first(self.table.num_rows)
        shape, *numbers = (self.table[f"target_{name}"] for name in ("shape", "length_m", "width_m", "yaw_rad"))
        return Targets(np.array(shape.to_pylist(), str), *(column.to_numpy().astype(np.float64) for column in numbers))

    @cached_property
    def timings(self) -> Sequence[Row]:
        """Rows of ``timings.parquet``, which no seal covers; MissingFileError or IntegrityError if unreadable."""
        path = self.source / TIMINGS_FILE
        if not path.is_file():
            raise MissingFileError(f"{path} does not exist", hint=AGAIN, path=str(path))
        try:
            table = parquet_table(path, page_checksum_verification=True).select(TIMINGS_SCHEMA.names)
            if table.schema.types != TIMINGS_SCHEMA.types or any(column.null_count for column in table.columns):
                raise ValueError("it does not have the columns that it should have")
            rows: list[Row] = table.to_pylist()
        except (pa.ArrowException, KeyError, OSError, ValueError) as error:
            reason = first_line(error)
            raise IntegrityError(f"{path} cannot be read: {reason}", hint=AGAIN, path=str(path)) from error
        return rows

    @property
    def results_path(self) -> Path:
        """Where the results table lies."""
        return self.source / results_name(self.header)

    def faults(self) -> list[Row]:
        """Answers that are not an action: ``index``, ``step``, ``reason``, ``detail``; an IntegrityError if damaged."""
        if not self.counts.policy_errors:
            return []
        answers = (row for _, row in read_journal(self.source / "records", ANSWERS))
        return [row for row in answers if row["action"] is None and row["index"] < self.counts.episodes]

    def refusal(self) -> IntegrityError:
        """The error that names what changed."""
        named = "; ".join(map(str, self.findings[:_FINDINGS_NAMED]))
        more = len(self.findings) - _FINDINGS_NAMED
        return IntegrityError(
            f"{self.source} is refused: {named}{f'; and {more:,} more' if more > 0 else ''}",
            hint=f"see all of it: rema replay {self.source}; or evaluate the policy again",
            path=str(self.source / self.findings[0].file),
            findings=self.findings,
        )

    def no_folder(self) -> InputError:
        """The error of an entry where a run folder is needed, or derived results."""
        hint = "give the folder of the run that it was made from, or derive its results: rema leaderboard --verify"
        return InputError(f"{self.source} is an entry: it holds no table", hint=hint, path=str(self.source))
