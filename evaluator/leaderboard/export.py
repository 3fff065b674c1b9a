"""The leaderboard as text for other programs and documents: Markdown, HTML, LaTeX, CSV and JSON."""

from __future__ import annotations

import csv
import dataclasses
import html
import io
import json
from collections.abc import Callable, Iterable, Sequence
from itertools import groupby

from evaluator.leaderboard import PUBLISHED, Board, Row, apart
from evaluator.leaderboard.escape import one_line, to_csv, to_latex, to_markdown, web_link
from evaluator.leaderboard.suites import BOARD_SUITE, SuiteRow
from evaluator.protocol import BLANKED
from evaluator.statistics import format_interval, percent
from rema_data.schema import TASKS

__all__ = ["COLUMNS", "FORMATS", "board_html", "cells", "export", "html_page", "matrix", "titled_groups"]

COLUMNS = (
    "task",
    "policy",
    "tag",
    "protocol",
    "rank",
    "k/n",
    "rate %",
    "95 %",
    "ties",
    "end-to-end %",
    "hard %",
    "clean - fresh",
    *(f"{name} %" for name in BLANKED),
    "funnel %",
    "z",
    "errors",
    "failures",
    "sandbox",
)
"""Titles of ``cells``."""
_IN_TITLE = ("task", "protocol")
_SHORT_HASH = 8


def export(board: Board, form: str) -> str:
    """``board`` as ``md``, ``html``, ``tex``, ``csv`` or ``json``, ending with a newline."""
    return FORMATS[form](board)


def cells(row: Row) -> tuple[str, ...]:
    """The row as people read it, in the order of the columns."""
    failures = sorted((row.failures or {}).items(), key=lambda item: (-item[1], item[0]))
    errors = [
        f"{count} {kind}" for kind, count in (("policy", row.policy_errors), ("infra", row.infra_errors)) if count
    ]
    if row.bounds is not None:
        errors.append(f"rate in {format_interval(row.bounds)}")
    if row.audit is not None and row.audit.action_flips:
        errors.append(f"{row.audit.action_flips} of {row.audit.actions} repeated actions flipped")
    return (
        row.task,
        row.policy,
        _kind(row.tag),
        row.protocol,
        "-" if row.rank is None else str(row.rank),
        _counted(row),
        "-" if row.rate is None else percent(row.rate),
        "-" if row.ci95 is None else format_interval(row.ci95),
        row.ties,
        "" if row.end_to_end is None else percent(row.end_to_end),
        "" if row.hard is None else percent(row.hard) + (" adapted" if row.adapted else ""),
        "" if row.fresh is None else "{:+.1f} [{:+.1f}, {:+.1f}]".format(*(100 * end for end in row.fresh[:3])),
        *(percent(row.blank[name]) if row.blank and name in row.blank else "" for name in BLANKED),
        _funnel(row),
        "" if row.z is None else f"{row.z:+.1f}",
        ", ".join(errors),
        ", ".join(f"{label} {count}" for label, count in failures[:3]),
        row.isolation,
    )


def _kind(tag: str) -> str:
    """A tag as people read it: a learned row is of one checkpoint, and says nothing of the method that trained it."""
    return "learned checkpoint" if tag == "learned" else tag


def _counted(row: Row) -> str:
    if row.successes is not None:
        return f"{row.successes}/{row.episodes}"
    return f"> {row.episodes}" if row.tag == PUBLISHED else "-"


def _funnel(row: Row) -> str:
    """Share of all measured episodes that passed each step, where the policy plays several."""
    if len(row.funnel) < 2 or not row.episodes:
        return ""
    return " > ".join(percent(min(1.0, step.succeeded / row.episodes)) for step in row.funnel)


def titled_groups(board: Board) -> list[tuple[str, list[Row]]]:
    """The tables of the board, each with its title: one a task and protocol, and one for what is not verified there."""
    groups = []
    for (task, protocol, unverified), found in groupby(
        board.rows, key=lambda row: (row.task, row.protocol, apart(row))
    ):
        rows = list(found)
        marks = {(row.scenarios_hash, row.protocol_hash) for row in rows if row.scenarios_hash and not row.unranked}
        title = f"{task}, {protocol}" + (": not verified" if unverified else "")
        for scenarios, rules in sorted(marks):
            title += f" (scenarios {scenarios[:_SHORT_HASH]}, protocol {rules[:_SHORT_HASH]})"
        groups.append((title, rows))
    return groups


def matrix(board: Board, protocol: str) -> tuple[list[str], list[list[str]]]:
    """The header and the lines of a table with one line a policy and one column a task: rate, interval and letters.

    Policies without a rank are left out, except privileged and published ones, and, after the others, those of which
    the numbers are not verified. Empty cells: not scored. Behind a task stands its ``hard`` column, where a policy was
    played over a suite; a dash for those that were not.
    """
    shown = [
        row
        for row in board.rows
        if row.protocol == protocol
        and (not row.unranked or row.tag == PUBLISHED or (apart(row) and row.rate is not None))
    ]
    tasks = [task for task in TASKS if any(row.task == task for row in shown)]
    lines: dict[tuple[int, str, str, int], dict[str, Row]] = {}
    for row in shown:
        number = 1  # policies of one name stay apart
        while row.task in lines.setdefault(key := (_block(row), row.policy, row.tag, number), {}):
            number += 1
        lines[key][row.task] = row
    order = sorted(lines, key=lambda key: (key[0], -max(row.rate or 0.0 for row in lines[key].values()), key))
    ranked = [row for row in board.suites if not row.unranked and row.suite == BOARD_SUITE]
    hardened = {row.same_policy: row for row in reversed(ranked)}
    hard = [task for task in tasks if any(row.task == task and row.hard is not None for row in shown)]
    header, made = ["policy", "kind"], []
    for task in tasks:
        header += [task, f"{task} hard"] if task in hard else [task]
    for key in order:
        line = [
            key[1] + (f" ({key[3]})" if key[3] > 1 else ""),
            _kind(key[2]) + (", not verified" if key[0] == 1 else ""),
        ]
        for task in tasks:
            scored = lines[key].get(task)
            line.append("" if scored is None else _short(scored))
            if task in hard:
                found = None if scored is None or scored.hard is None else hardened.get(scored.same_policy)
                line.append("-" if found is None else _short_hard(found))
        made.append(line)
    return header, made


def _block(row: Row) -> int:
    """Verified rows stand first, then the others, then the published ones."""
    return 2 if row.tag == PUBLISHED else int(apart(row))


def _short(row: Row) -> str:
    if row.rate is None or row.ci95 is None:
        return "-"
    if row.tag == PUBLISHED:
        return percent(row.rate)
    return f"{percent(row.rate)} [{format_interval(row.ci95)}] {row.ties}".strip()


def _short_hard(row: SuiteRow) -> str:
    interval = "" if row.score.interval is None else f"[{format_interval(row.score.interval)}]"
    parts = ("-" if row.score.hard is None else percent(row.score.hard), interval, row.ties)
    return " ".join(filter(None, (*parts, "adapted" if row.adapted else "")))


def markdown_table(header: Sequence[str], lines: Iterable[Iterable[str]]) -> str:
    """A Markdown table of cells that are Markdown: see ``to_markdown`` for text from elsewhere."""
    whole = [header, ["---"] * len(header), *lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in whole)


def _markdown(board: Board) -> str:
    rows = [[to_markdown(cell) for cell in cells(row)] for row in board.rows]
    return "\n\n".join([markdown_table(COLUMNS, rows), *map(to_markdown, board.remarks)]) + "\n"


def _html(board: Board) -> str:
    """A page of its own, without anything from elsewhere."""
    return html_page("rema leaderboard", board_html(board, lambda row: web_link(row.link)))


def html_page(title: str, body: str) -> str:
    """A page with a body that is HTML."""
    return f"{_HTML_HEAD.replace('TITLE', html.escape(title))}\n{body}\n</body>\n</html>\n"


def board_html(board: Board, address: Callable[[Row], str]) -> str:
    """The tables of the board and its remarks; the names of policies lead to an address, where it is not empty."""
    parts = []
    for title, rows in titled_groups(board):
        parts.append(f"<h2>{html.escape(title)}</h2>\n<div><table>")
        parts.append("<tr>" + "".join(f"<th>{html.escape(name)}</th>" for name in _without_title(COLUMNS)) + "</tr>")
        for row in rows:
            line = [html.escape(cell) for cell in _without_title(cells(row))]
            if link := address(row):
                line[0] = f'<a href="{html.escape(link)}">{line[0]}</a>'
            body = "".join(f"<td>{cell}</td>" for cell in line)
            parts.append(f'<tr class="{html.escape(row.tag)}">{body}</tr>')
        parts.append("</table></div>")
    parts += [f"<p>{html.escape(remark)}</p>" for remark in board.remarks]
    return "\n".join(parts)


_HTML_HEAD = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>TITLE</title>
<style>
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 75rem; padding: 0 1rem; }
div { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { border-bottom: 1px solid #8884; padding: .3rem .7rem; text-align: left; white-space: nowrap; }
.published { opacity: .65; font-style: italic; }
p { max-width: 50rem; }
</style>
</head>
<body>
<h1>TITLE</h1>"""


def _latex(board: Board) -> str:
    """Tables for a paper that uses the package booktabs."""
    columns = _without_title(COLUMNS)
    parts = ["% needs \\usepackage{booktabs}"]
    for title, rows in titled_groups(board):
        parts += [
            "\\begin{table}",
            "\\centering",
            f"\\caption{{{to_latex(title)}}}",
            f"\\begin{{tabular}}{{{'l' * len(columns)}}}",
            "\\toprule",
            " & ".join(map(to_latex, columns)) + r" \\",
            "\\midrule",
            *(" & ".join(map(to_latex, _without_title(cells(row)))) + r" \\" for row in rows),
            "\\bottomrule",
            "\\end{tabular}",
            "\\end{table}",
            "",
        ]
    return "\n".join([*parts, *(f"% {one_line(remark)}" for remark in board.remarks)]) + "\n"


def _without_title(line: Sequence[str]) -> list[str]:
    return [cell for name, cell in zip(COLUMNS, line, strict=True) if name not in _IN_TITLE]


_PAIRS = ("ci95", "bounds")
_NESTED = ("failures", "funnel", "audit", "fresh", "blank")


def _csv(board: Board) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    plain = [field.name for field in dataclasses.fields(Row) if field.name not in (*_PAIRS, *_NESTED)]
    ends = [f"{name}_{end}" for name in _PAIRS for end in ("low", "high")]
    writer.writerow([*plain, *ends, *_NESTED])
    for row in board.rows:
        content = dataclasses.asdict(row)
        line = ["" if content[name] is None else content[name] for name in plain]
        for name in _PAIRS:
            line += content[name] or ("", "")
        writer.writerow(
            [
                *map(to_csv, line),
                *(json.dumps(content[name], sort_keys=True) if content[name] else "" for name in _NESTED),
            ]
        )
    return text.getvalue()


def _json(board: Board) -> str:
    return (
        json.dumps({"rows": [dataclasses.asdict(row) for row in board.rows], "remarks": board.remarks}, indent=2) + "\n"
    )


FORMATS: dict[str, Callable[[Board], str]] = {
    "md": _markdown,
    "html": _html,
    "tex": _latex,
    "csv": _csv,
    "json": _json,
}
"""Formats by name."""
