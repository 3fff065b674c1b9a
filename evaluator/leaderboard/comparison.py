"""Two runs on the same scenarios: the 2x2 table, the paired difference, where they differ, and the limits of it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from evaluator.run.run import Run
from evaluator.scenarios import VERSION, installed_list
from evaluator.scenarios.strata import Targets, strata, targets_of_list
from evaluator.sim.bullet import decisive
from evaluator.statistics import (
    PairTable,
    benjamini_hochberg,
    detectable_difference,
    midp_mcnemar,
    pair_table,
    paired_interval,
    rate_interval,
)
from rema_data.errors import InputError

__all__ = ["Comparison", "StratumRow", "compare"]


@dataclass(frozen=True, slots=True)
class StratumRow:
    """The comparison within a stratum; exploratory."""

    by: str
    label: str
    table: PairTable
    interval: tuple[float, float]  # 95 % of the difference
    p_adjusted: float  # mid-p McNemar, Benjamini-Hochberg over all strata


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """A against B on the scenarios that both were measured on."""

    a: Run
    b: Run
    table: PairTable
    interval: tuple[float, float]  # 95 % of A's rate minus B's (Newcombe, paired)
    p: float  # mid-p McNemar, two-sided
    detectable: float | None  # smallest difference found with 80 % power at this discordance
    strata: tuple[StratumRow, ...]
    only_a: tuple[int, ...]  # scenarios (numbers in the list) that only A solved
    only_b: tuple[int, ...]  # and only B
    remarks: tuple[str, ...]  # what limits the comparison

    def to_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON; rates and differences are shares in 0..1."""
        table = self.table
        return {
            "task": self.a.task,
            "split": self.a.split,
            "protocol": self.a.protocol,
            "a": _side(self.a, table.both + table.only_a, table.n),
            "b": _side(self.b, table.both + table.only_b, table.n),
            **_numbers(table, self.interval),
            "p": self.p,
            "detectable_difference": self.detectable,
            "strata": [
                {"by": row.by, "label": row.label, **_numbers(row.table, row.interval), "p_adjusted": row.p_adjusted}
                for row in self.strata
            ],
            "discordant": {"only_a": list(self.only_a), "only_b": list(self.only_b)},
            "remarks": list(self.remarks),
        }


def _side(run: Run, successes: int, n: int) -> dict[str, Any]:
    return {
        "policy": run.policy,
        "tag": run.tag,
        "source": str(run.source),
        "policy_digest": run.provenance.policy_digest,
        "successes": successes,
        "rate": successes / n,
        "ci95": list(rate_interval(successes, n)),
    }


def _numbers(table: PairTable, interval: tuple[float, float]) -> dict[str, Any]:
    return {
        "n": table.n,
        "table": dataclasses.asdict(table),
        "rate_a": table.rate_a,
        "rate_b": table.rate_b,
        "difference": table.difference,
        "difference_ci95": list(interval),
        "discordance": table.discordance,
    }


def compare(a: Run, b: Run) -> Comparison:
    """Compare two runs, scenario by scenario, on the scenarios that both have; see ``evaluator.compare``.

    Scenarios that one of them lost to the infrastructure are left out and named in the remarks.
    """
    _check_comparable(a, b)
    ours, theirs = a.outcomes, b.outcomes
    n = min(len(ours.success), len(theirs.success))
    counted = ours.eligible[:n] & theirs.eligible[:n]
    left, right = ours.success[:n], theirs.success[:n]
    table = pair_table(left, right, counted)
    targets, excuse = _targets(a, b)
    remarks = _remarks(a, b, n, int((~counted).sum()))
    return Comparison(
        a=a,
        b=b,
        table=table,
        interval=paired_interval(table),
        p=midp_mcnemar(table),
        detectable=detectable_difference(table.n, table.discordance),
        strata=() if targets is None else _stratum_rows(targets.first(n), left, right, counted),
        only_a=tuple(np.flatnonzero(counted & left & ~right).tolist()),
        only_b=tuple(np.flatnonzero(counted & right & ~left).tolist()),
        remarks=(*remarks, *([excuse] if excuse else [])),
    )


def _check_comparable(a: Run, b: Run) -> None:
    """Raise an InputError, with the field and both values, where two runs do not compare."""
    for field, first in a.comparable.items():
        if (second := b.comparable[field]) != first:
            raise InputError(
                f"the runs do not compare: {field} is {first or 'not recorded'} in {a.source} and "
                f"{second or 'not recorded'} in {b.source}",
                hint="evaluate both policies with the same task, protocol and scenario list",
                field=field,
                a=first,
                b=second,
            )


def _remarks(a: Run, b: Run, n: int, lost: int) -> list[str]:
    found = []
    if decisive(a.provenance.fingerprint) != decisive(b.provenance.fingerprint):
        found.append(
            "ANOTHER SIMULATOR: the runs come from different builds or constants of the simulator "
            f"({_differences(a, b)}). A part of the difference may be the simulator's: evaluate one of them again."
        )
    if a.counts.episodes != b.counts.episodes:
        found.append(f"The runs differ in length: only the {n:,} scenarios that both played are compared.")
    if lost:
        found.append(
            f"{lost:,} scenarios are left out: they have no result in one of the runs. The difference could "
            f"be {100 * lost / n:.2g} points larger or smaller."
        )
    for run in (a, b):
        if run.unfinished:
            found.append(
                f"{run.source}: {run.unfinished:,} of its episodes were not finished. The others need not be a fair "
                "sample: in a run that was stopped, failures of the policy are counted before anything is simulated."
            )
    for run in (a, b):
        if run.kind == "entry" and not run.verified:
            found.append(f"NOT VERIFIED: the outcomes of {run.source} are what it says; it holds no actions.")
    if a.stopped_early or b.stopped_early:
        found.append("A run was stopped early because of its outcomes: its interval and p value are too optimistic.")
    for run in (a, b):
        if run.nondeterministic:
            found.append(f"{run.source}: {run.nondeterministic} steps had two different outcomes.")
    if a.privileged != b.privileged:
        found.append("One of the policies is privileged: it saw the ground truth.")
    return found


def _differences(a: Run, b: Run) -> str:
    first, second = a.provenance.fingerprint, b.provenance.fingerprint
    names = [name for name in sorted({*first, *second}) if first.get(name) != second.get(name)]
    return ", ".join(f"{name} {str(first.get(name))[:12]} and {str(second.get(name))[:12]}" for name in names)


def _targets(a: Run, b: Run) -> tuple[Targets | None, str]:
    """The objects of the scenarios, from a run folder or the installed list; or why they are not known."""
    for run in (a, b):
        if run.kind == "run":
            return run.targets, ""
    version = a.version or VERSION
    known = installed_list(a.task, a.split, version)
    if known is None or known[0] != a.provenance.scenarios_hash:
        return None, "No breakdown: this installation does not have the scenario list of these entries."
    return targets_of_list(a.task, a.split, version), ""


def _stratum_rows(
    targets: Targets, a: npt.NDArray[np.bool_], b: npt.NDArray[np.bool_], counted: npt.NDArray[np.bool_]
) -> tuple[StratumRow, ...]:
    kept = [stratum for stratum in strata(targets) if (stratum.members & counted).any()]
    tables = [pair_table(a, b, stratum.members & counted) for stratum in kept]
    adjusted = benjamini_hochberg([midp_mcnemar(table) for table in tables])
    return tuple(
        StratumRow(stratum.by, stratum.label, table, paired_interval(table), p)
        for stratum, table, p in zip(kept, tables, adjusted, strict=True)
    )
