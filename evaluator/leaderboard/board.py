"""The leaderboard: rows in order, and the remarks below them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from evaluator.leaderboard.blank import blank_rates, blank_remarks
from evaluator.leaderboard.copies import in_order, once
from evaluator.leaderboard.fresh import fresh_counts, fresh_gaps, fresh_remarks
from evaluator.leaderboard.naming import PUBLISHED
from evaluator.leaderboard.ranking import LEVEL, Pair, rank_runs
from evaluator.leaderboard.row import Row, published_rows, row_of
from evaluator.leaderboard.suites import BOARD_SUITE, SuiteRow, suite_rows
from evaluator.leaderboard.verification import NOT_SIMULATED, known, records, verify
from evaluator.protocol import BLANKED
from evaluator.rollout.backend import Backend
from evaluator.run.reading import read_run
from evaluator.run.run import Run
from evaluator.sim.bullet import decisive
from evaluator.statistics import detectable_difference
from rema_data.errors import RemaError, RunMismatchError
from rema_data.progress import Progress
from rema_data.schema import TASKS

__all__ = ["PUBLISHED_REMARK", "Board", "apart", "find_runs", "leaderboard"]

PUBLISHED_REMARK = (
    "published: rates of the paper's Table 2, over more than 10,000 episodes each. Its scenes and its simulator are "
    "not ours, so z (same policy, ours minus published, in standard errors) says how close the worlds are, "
    "not who is better."
)


@dataclass(frozen=True, slots=True)
class Board:
    """The table."""

    # by task and protocol: ranked and published rows by rate, the others by rate, and those that are not verified
    rows: tuple[Row, ...]
    remarks: tuple[str, ...]  # what the rows mean, and which of them do not compare
    refused: tuple[RemaError, ...] = ()  # why a source is not among the rows; each is a remark as well
    suites: tuple[SuiteRow, ...] = ()  # runs over generalisation suites, by ``hard``


def leaderboard(
    sources: Sequence[Path],
    published: bool = True,
    *,
    simulate: bool = False,
    engine: str = "process",
    progress: Progress | None = None,
    backend: Backend | None = None,
) -> Board:
    """The board of some run folders and entries, and of the paper; see ``evaluator.leaderboard``.

    ``simulate``: simulate the actions of what is not verified; otherwise it stands apart. Runs and entries with the
    same actions are shown once. An unfinished or changed source is left out and named. The paper's rows are those of
    the tasks of the sources, or all where there is no source.
    """

    def settled(run: Run) -> Run:
        if not simulate:
            return run
        try:
            return verify(run, progress, backend=backend, engine=engine)
        except RunMismatchError:
            return run  # of another list or protocol: it has no rank in any case

    read, refused = _read(sources, settled, backend)
    everything, copies = once(in_order(read, records()))
    clean = [run for run in everything if not run.suite and not run.fresh]
    runs = [run for run in clean if run.protocol not in BLANKED]
    blank = [run for run in clean if run.protocol in BLANKED]
    refreshed = [run for run in everything if run.fresh]
    fresh = fresh_counts(refreshed)
    standings, pairs = rank_runs(runs)
    # Beside a row stands only what would have a rank of its own; of several such runs the first.
    rates: dict[bool, dict[tuple[str, str, str], float | None]] = {False: {}, True: {}}  # by ``end_to_end``
    for run, standing in zip(runs, standings, strict=True):
        if not standing.unranked:
            rates[run.end_to_end].setdefault(run.same_policy, run.counts.rate)
    hardened = suite_rows([run for run in everything if run.suite], rates[False])
    hard = {row.same_policy: row for row in reversed(hardened) if not row.unranked and row.suite == BOARD_SUITE}
    blanked = blank_rates(blank)
    rows = []
    for run, standing, gap in zip(runs, standings, fresh_gaps(runs, fresh), strict=True):
        beside: dict[str, Any] = {}
        if not run.end_to_end:
            beside = {"end_to_end": rates[True].get(run.same_policy), "blank": blanked.get(run.same_policy)}
            if (found := hard.get(run.same_policy)) is not None:
                beside |= {"hard": found.score.hard, "adapted": found.adapted}
        rows.append(row_of(run, **asdict(standing), fresh=gap, **beside))
    if published:
        tasks = {row.task for row in rows} or set(TASKS)
        rows += [row for row in published_rows() if row.task in tasks]
    rows.sort(key=_place)
    conditional = {run.same_policy for run in runs if not run.end_to_end}
    left_out = [f"LEFT OUT: {error.message} ({error.hint})" for error in refused]
    shown_once = [
        f"{copy.policy} ({copy.source.name}) has the actions of {first.policy} and is shown as that one."
        for copy, first in copies
        if (copy.policy, copy.provenance.policy_digest) != (first.policy, first.provenance.policy_digest)
    ]
    unseen = fresh_remarks(refreshed, {(run.protocol, run.same_policy) for run in runs})
    remarks = (*left_out, *shown_once, *_remarks(rows, pairs), *blank_remarks(blank, conditional), *unseen)
    return Board(tuple(rows), remarks, refused, tuple(hardened))


def _read(
    sources: Sequence[Path], verified: Callable[[Run], Run], backend: Backend | None
) -> tuple[list[Run], tuple[RemaError, ...]]:
    """The runs that can be read, with what is known about them, and why the others cannot."""
    runs, refused = [], []
    for source in sources:
        try:
            run = known(read_run(source), backend)
            runs.append(run if run.verified or not run.has_actions else verified(run))
        except RemaError as error:
            refused.append(error)
    if refused and not runs:
        raise refused[0]
    return runs, tuple(refused)


def find_runs(folder: Path) -> list[Path]:
    """Run folders below ``folder`` that have a summary, sorted."""
    return sorted(path.parent for path in folder.glob("*/summary.json"))


def _place(row: Row) -> tuple[object, ...]:
    last = bool(row.unranked) and row.tag != PUBLISHED
    return (
        list(TASKS).index(row.task),
        row.protocol,
        apart(row),
        last,
        -(row.rate or 0.0),
        row.tag,
        row.policy,
        row.source,
    )


def apart(row: Row) -> bool:
    """Whether a row stands apart, because its actions were not simulated."""
    return not row.verified and row.tag != PUBLISHED


def _remarks(rows: Sequence[Row], pairs: Sequence[Pair]) -> Iterator[str]:
    if any(row.tag == PUBLISHED for row in rows):
        yield PUBLISHED_REMARK
    if pairs:
        yield (
            "ties: policies of one table that share a letter do not differ significantly (mid-p McNemar on the same "
            f"scenarios, Holm over the {len(pairs)} {'pair' if len(pairs) == 1 else 'pairs'} of the board, "
            f"p > {LEVEL:g}). {_power(pairs)}"
        )
    if any(row.tag == "privileged" for row in rows):
        yield "privileged: it saw the ground truth, so it has letters but no rank."
    if any(row.tag == "simulator" for row in rows):
        yield "simulator: it carries a simulator or the scenario list, so it has letters but no rank."
    if any(apart(row) for row in rows):
        yield (
            "NOT VERIFIED: rows that stand apart are claims: their actions were not simulated here, and no "
            "verification record covers them. `rema leaderboard --verify` simulates those that hold actions."
        )
    for row in rows:
        if row.unranked and row.tag != PUBLISHED and not (apart(row) and row.unranked.endswith(NOT_SIMULATED)):
            yield f"{row.policy} ({row.task}, {row.protocol}) has no rank: {row.unranked}."
    for (task, protocol, policy), count in Counter(
        (row.task, row.protocol, row.policy) for row in rows if row.verified
    ).items():
        if count > 1:
            yield f"{count} rows of {task} ({protocol}) are called {policy}: they have different actions."
    for task, protocol in dict.fromkeys((row.task, row.protocol) for row in rows):
        ranked = [row for row in rows if (row.task, row.protocol) == (task, protocol) and not row.unranked]
        marks = [decisive(json.loads(row.fingerprint or "{}")) for row in ranked]
        if any(mark != marks[0] for mark in marks):
            yield (
                f"ANOTHER SIMULATOR: the runs of {task} ({protocol}) come from different builds or constants of the "
                "simulator: a part of their difference may be the simulator's."
            )
    for row in rows:
        if row.fresh is not None and row.fresh.falls:
            gap, low, high = (f"{100 * end:.1f}" for end in row.fresh[:3])
            yield (
                f"FRESH: {row.policy} ({row.task}, {row.protocol}) solves fewer fresh scenarios, by {gap} points "
                f"[{low}, {high}]: what it does on the frozen list does not carry over."
            )
    if any(row.infra_errors for row in rows):
        yield "Episodes lost to the infrastructure are in no denominator; the bounds count them as failed, or solved."
    if any(row.tag != PUBLISHED for row in rows):
        yield "Intervals are of one checkpoint, not of a training method: that would need several trainings."


def _power(pairs: Sequence[Pair]) -> str:
    """The smallest difference that these pairs could have shown, one by one."""
    found = [
        difference
        for pair in pairs
        if (difference := detectable_difference(pair.table.n, pair.table.discordance)) is not None
    ]
    if not found:
        return "At so few discordant scenarios no difference could have been shown with 80 % power."
    low, high = (f"{100 * end:.2f}" for end in (min(found), max(found)))
    span = low if low == high else f"{low} to {high}"
    return (
        f"Smallest difference that a single pair shows with 80 % power: {span} points, by how often the two disagree."
    )
