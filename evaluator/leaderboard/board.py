"""The leaderboard: rows in order, and the remarks below them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from evaluator.leaderboard.ranking import LEVEL, Pair, rank_runs
from evaluator.leaderboard.row import PUBLISHED, Row, published_rows, row_of
from evaluator.run.reading import read_run
from evaluator.run.run import Run
from evaluator.sim.bullet import decisive
from evaluator.statistics import detectable_difference
from rema_data.errors import RemaError
from rema_data.schema import TASKS

__all__ = ["PUBLISHED_REMARK", "Board", "find_runs", "leaderboard"]

PUBLISHED_REMARK = (
    "published: rates of the paper's Table 2, over more than 10,000 episodes each. Its scenes and its simulator are "
    "not ours, so z (same policy, ours minus published, in standard errors) says how close the worlds are, "
    "not who is better."
)


@dataclass(frozen=True, slots=True)
class Board:
    """The table."""

    rows: tuple[Row, ...]  # by task and protocol: ranked and published rows by rate, then the others by rate
    remarks: tuple[str, ...]  # what the rows mean, and which of them do not compare
    refused: tuple[RemaError, ...] = ()  # why a source is not among the rows; each is a remark as well


def leaderboard(sources: Sequence[Path], published: bool = True) -> Board:
    """The board of some run folders and submission files, and of the paper; see ``evaluator.leaderboard``.

    A run that is also there as a submission is shown once. An unfinished or changed source is left out and named. The
    paper's rows are those of the tasks of the sources, or all where there is no source.
    """
    read, refused = _read(sources)
    runs = _once(read)
    standings, pairs = rank_runs(runs)
    whole = {
        _policy(run): run.counts.rate
        for run, standing in zip(runs, standings, strict=True)
        if run.end_to_end and not standing.unranked
    }
    rows = [
        row_of(run, **asdict(standing), end_to_end=None if run.end_to_end else whole.get(_policy(run)))
        for run, standing in zip(runs, standings, strict=True)
    ]
    if published:
        tasks = {row.task for row in rows} or set(TASKS)
        rows += [row for row in published_rows() if row.task in tasks]
    rows.sort(key=_place)
    left_out = [f"LEFT OUT: {error.message} ({error.hint})" for error in refused]
    return Board(tuple(rows), (*left_out, *_remarks(rows, pairs)), refused)


def _read(sources: Sequence[Path]) -> tuple[list[Run], tuple[RemaError, ...]]:
    """The runs that can be read, and why the others cannot."""
    runs, refused = [], []
    for source in sources:
        try:
            runs.append(read_run(source))
        except RemaError as error:
            refused.append(error)
    if refused and not runs:
        raise refused[0]
    return runs, tuple(refused)


def find_runs(folder: Path) -> list[Path]:
    """Run folders below ``folder`` that have a summary, sorted."""
    return sorted(path.parent for path in folder.glob("*/summary.json"))


def _once(runs: Sequence[Run]) -> list[Run]:
    """Runs without copies of an earlier one; submissions come first, as they carry a name and a link."""
    kept: dict[tuple[object, ...], Run] = {}
    for number, run in enumerate(sorted(runs, key=lambda run: run.kind != "entry")):
        same: tuple[object, ...] = (number,)
        if run.provenance.policy_digest:
            bits = (run.outcomes.success.tobytes(), run.outcomes.eligible.tobytes())
            marks = (run.provenance.policy_digest, run.provenance.scenarios_hash)
            same = (run.task, run.protocol, run.split, *marks, *bits)
        kept.setdefault(same, run)
    return list(kept.values())


def _policy(run: Run) -> tuple[str, str]:
    return run.task, run.provenance.policy_digest or str(run.source)


def _place(row: Row) -> tuple[object, ...]:
    last = bool(row.unranked) and row.tag != PUBLISHED
    return list(TASKS).index(row.task), row.protocol, last, -(row.rate or 0.0), row.tag, row.policy, row.source


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
    for row in rows:
        if row.unranked and row.tag != PUBLISHED:
            yield f"{row.policy} ({row.task}, {row.protocol}) has no rank: {row.unranked}."
    for task, protocol in dict.fromkeys((row.task, row.protocol) for row in rows):
        ranked = [row for row in rows if (row.task, row.protocol) == (task, protocol) and not row.unranked]
        marks = [decisive(json.loads(row.fingerprint or "{}")) for row in ranked]
        if any(mark != marks[0] for mark in marks):
            yield (
                f"ANOTHER SIMULATOR: the runs of {task} ({protocol}) come from different builds or constants of the "
                "simulator: a part of their difference may be the simulator's."
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
