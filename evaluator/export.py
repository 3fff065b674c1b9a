"""The leaderboard as text for other programs and documents: Markdown, CSV and JSON."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from collections.abc import Callable, Sequence

from evaluator.leaderboard import Row, remarks

__all__ = ["COLUMNS", "FORMATS", "cells", "export"]

COLUMNS = ("task", "policy", "tag", "protocol", "k/n", "rate %", "95 %", "z", "errors", "failures")
"""Titles of ``cells``."""


def export(rows: Sequence[Row], form: str) -> str:
    """``rows`` as ``md``, ``csv`` or ``json``, ending with a newline."""
    return FORMATS[form](rows)


def cells(row: Row) -> tuple[str, ...]:
    """The row as people read it, in the order of the columns; rates with one decimal."""
    low, high = row.ci95 or (0.0, 1.0)
    failures = sorted((row.failures or {}).items(), key=lambda item: -item[1])
    errors = [
        f"{count} {kind}" for kind, count in (("policy", row.policy_errors), ("infra", row.infra_errors)) if count
    ]
    return (
        row.task,
        row.policy,
        row.tag,
        row.protocol,
        f"> {row.episodes}" if row.successes is None else f"{row.successes}/{row.episodes}",
        "-" if row.rate is None else f"{100 * row.rate + 1e-9:.1f}",
        "-" if row.ci95 is None else f"{100 * low:.1f} .. {100 * high:.1f}",
        "" if row.z is None else f"{row.z:+.1f}",
        ", ".join(errors),
        ", ".join(f"{label} {count}" for label, count in failures[:3]),
    )


def _markdown(rows: Sequence[Row]) -> str:
    lines = [COLUMNS, tuple("---" for _ in COLUMNS), *(cells(row) for row in rows)]
    table = "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines)
    return "\n\n".join([table, *remarks(rows)]) + "\n"


def _csv(rows: Sequence[Row]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [field.name for field in dataclasses.fields(Row) if field.name not in ("ci95", "failures")]
    writer.writerow([*names, "ci95_low", "ci95_high", "failures"])
    for row in rows:
        low, high = row.ci95 or ("", "")
        plain = ["" if getattr(row, name) is None else getattr(row, name) for name in names]
        writer.writerow([*plain, low, high, json.dumps(row.failures or {}, sort_keys=True)])
    return text.getvalue()


def _json(rows: Sequence[Row]) -> str:
    return json.dumps({"rows": [dataclasses.asdict(row) for row in rows], "remarks": remarks(rows)}, indent=2) + "\n"


FORMATS: dict[str, Callable[[Sequence[Row]], str]] = {"md": _markdown, "csv": _csv, "json": _json}
"""Formats by name."""
