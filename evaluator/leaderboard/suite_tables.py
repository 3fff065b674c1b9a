"""The board of a suite as tables of text: a policy a line, an axis a column."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from collections.abc import Callable, Sequence

from evaluator.leaderboard.board import Board
from evaluator.leaderboard.escape import to_csv, to_markdown
from evaluator.leaderboard.export import markdown_table
from evaluator.leaderboard.suites import SuiteRow
from evaluator.scenarios.suites import check_suite
from evaluator.statistics import format_interval, percent
from rema_data.schema import TASKS

__all__ = ["SUITE_FORMATS", "SuiteTable", "rows_of_suite", "share", "suite_remarks", "suite_tables", "trained"]


@dataclasses.dataclass(frozen=True, slots=True)
class SuiteTable:
    """One task of a suite."""

    title: str
    header: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]


def rows_of_suite(board: Board, suite: str) -> list[SuiteRow]:
    """The rows of a suite, by task, training and ``hard``; InputError for a suite that is not here."""
    check_suite(suite)
    order = list(TASKS)
    return sorted(
        (row for row in board.suites if row.suite == suite), key=lambda row: (order.index(row.task), row.adapted)
    )


def suite_tables(board: Board, suite: str) -> list[SuiteTable]:
    """A table for every task that was played, and behind it that of the policies trained on changed situations."""
    rows = rows_of_suite(board, suite)
    tables = []
    for task, adapted in dict.fromkeys((row.task, row.adapted) for row in rows):
        own = [row for row in rows if (row.task, row.adapted) == (task, adapted)]
        axes = tuple(axis.name if axis.counts else f"({axis.name})" for axis in own[0].score.axes)
        header = ("policy", "tag", "rank", "hard %", "95 %", "ties", "clean %", "kept %", "worst axis", *axes)
        title = f"{suite}: {task}" + (", adapted" if adapted else "")
        tables.append(SuiteTable(title, header, tuple(_line(row) for row in own)))
    return tables


def suite_remarks(board: Board, suite: str) -> list[str]:
    """Why rows of a suite have no rank, and what lacks of their scenarios."""
    found = []
    for row in rows_of_suite(board, suite):
        if row.unranked:
            lacking = f" ({', '.join(row.score.lacking)})" if row.score.lacking else ""
            found.append(f"{row.policy} ({row.task}) has no rank: {row.unranked}{lacking}.")
    return found


def _line(row: SuiteRow) -> tuple[str, ...]:
    score, worst = row.score, row.score.worst
    return (
        row.policy,
        row.tag,
        "-" if row.rank is None else str(row.rank),
        share(score.hard),
        "-" if score.interval is None else format_interval(score.interval),
        row.ties,
        share(row.clean),
        share(row.retention),
        "-" if worst is None else worst.name,
        *(share(axis.mean) for axis in score.axes),
    )


def trained(adapted: bool) -> str:
    """What a policy was trained on, in a word."""
    return "adapted" if adapted else "clean"


def share(value: float | None) -> str:
    """A rate in %; a dash where there is none."""
    return "-" if value is None else percent(value)


def _markdown(board: Board, suite: str) -> str:
    parts = []
    for table in suite_tables(board, suite):
        parts += [f"**{to_markdown(table.title)}**", markdown_table(table.header, _escaped(table.lines))]
    parts += [to_markdown(remark) for remark in suite_remarks(board, suite)]
    return "\n\n".join(parts) + "\n"


def _escaped(lines: Sequence[Sequence[str]]) -> list[list[str]]:
    return [[to_markdown(cell) for cell in line] for line in lines]


def _csv(board: Board, suite: str) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["policy", "tag", "trained", "task", "axis", "level", "successes", "scenarios", "rate"])
    for row in rows_of_suite(board, suite):
        for axis in row.score.axes:
            for cell in axis.cells:
                rate = "" if cell.rate is None else cell.rate
                line = (
                    row.policy,
                    row.tag,
                    trained(row.adapted),
                    row.task,
                    axis.name,
                    cell.level,
                    cell.successes,
                    cell.of,
                    rate,
                )
                writer.writerow(map(to_csv, line))
    return text.getvalue()


def _json(board: Board, suite: str) -> str:
    rows = [dataclasses.asdict(row) for row in rows_of_suite(board, suite)]
    return json.dumps({"suite": suite, "rows": rows}, indent=2) + "\n"


SUITE_FORMATS: dict[str, Callable[[Board, str], str]] = {"md": _markdown, "csv": _csv, "json": _json}
"""Formats by name; ``csv`` has a line a cell."""
