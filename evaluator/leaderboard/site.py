"""The leaderboard as a few static pages for any web server: the board, a page of every policy, and how to submit."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from evaluator.leaderboard import PUBLISHED, Board, Row
from evaluator.leaderboard.escape import one_line, web_link
from evaluator.leaderboard.export import COLUMNS, board_html, cells, export, html_page
from evaluator.leaderboard.suite_tables import SUITE_FORMATS, share, suite_remarks, suite_tables
from evaluator.leaderboard.suites import SuiteRow
from evaluator.statistics import percent
from rema_data.interrupts import check
from rema_data.publish.folder import whole_folder
from rema_data.storage import write_atomic

__all__ = ["write_site"]

_FILES = ("json", "csv", "md", "tex")
_GUIDE = """\
<p>Everything runs on your machine; <code>docs/submit.md</code> of the repository has every condition.</p>
<ol>
<li>Write a policy, a class with <code>act</code> in a file of its own: <code>rema check my_policy.py</code> says what
would be refused.</li>
<li>Choose on the validation split: <code>rema evaluate my_policy.py --task grasp --split val --episodes 500</code></li>
<li>Score the final version on the test list: <code>rema evaluate my_policy.py --task grasp</code></li>
<li>Pack its actions into an entry: <code>rema submit runs/my_policy-grasp-conditional --name my_policy</code></li>
<li>Put the entry into <code>manifests/leaderboard/</code> in a pull request. Its actions are simulated again there,
with the code of the main branch, and the table is the comment.</li>
</ol>
<p>An entry holds actions and no number: every rate on these pages was derived by simulating them.</p>"""


def write_site(board: Board, target: Path) -> int:
    """Write the pages into the new folder ``target``; how many.

    Raises RunMismatchError where it holds something, and StorageError where the disk is full or may not be written;
    nothing is left then.
    """
    # Where a run lies on this machine, and what else lies there, is nobody's business.
    board = replace(
        board,
        remarks=board.remarks[len(board.refused) :],
        rows=tuple(replace(row, source=Path(row.source).name) for row in board.rows),
        suites=tuple(replace(row, source=Path(row.source).name) for row in board.suites),
    )
    suites = sorted({row.suite for row in board.suites})
    pages = _addresses((*board.rows, *board.suites))
    with whole_folder(target, "--output") as folder:
        downloads = ", ".join(f'<a href="board.{form}">{form}</a>' for form in _FILES)
        tables = board_html(board, lambda row: pages[_policy(row)])
        for suite in suites:
            for table in suite_tables(board, suite):
                tables += f"\n<h2>{html.escape(table.title)}</h2>\n{_table(table.header, table.lines)}"
            tables += "".join(f"\n<p>{html.escape(remark)}</p>" for remark in suite_remarks(board, suite))
            for form, made in SUITE_FORMATS.items():
                downloads += f', <a href="{suite}.{form}">{suite}.{form}</a>'
                write_atomic(folder / f"{suite}.{form}", made(board, suite))
        body = f'<p><a href="submit.html">How to submit</a>. The same as {downloads}.</p>\n{tables}'
        write_atomic(folder / "index.html", html_page("rema leaderboard", body))
        write_atomic(folder / "submit.html", _page("How to submit", _GUIDE, "index.html"))
        for form in _FILES:
            write_atomic(folder / f"board.{form}", export(board, form))
        for policy, address in pages.items():
            check()
            rows = [row for row in board.rows if _policy(row) == policy]
            hardened = [row for row in board.suites if _policy(row) == policy]
            body = "\n".join((f"<p>Kind: {html.escape(policy[1])}.</p>", *_row_parts(rows), *_suite_parts(hardened)))
            write_atomic(folder / address, _page(policy[0], body, "../index.html"))
    return len(pages) + 2


def _page(title: str, body: str, back: str) -> str:
    return html_page(one_line(title), f'<p><a href="{back}">The leaderboard</a></p>\n{body}')


def _policy(row: Row | SuiteRow) -> tuple[str, str]:
    """What has a page: policies of one name but of another kind have their own."""
    return row.policy, row.tag


def _addresses(rows: Iterable[Row | SuiteRow]) -> dict[tuple[str, str], str]:
    """The page of every policy; a name is whatever its author wrote, so a number keeps pages apart."""
    found: dict[tuple[str, str], str] = {}
    for row in rows:
        name = re.sub(r"[^a-z0-9]+", "-", row.policy.lower()).strip("-")[:40]
        found.setdefault(_policy(row), f"policies/{len(found) + 1}-{name or 'policy'}.html")
    return found


def _row_parts(rows: Sequence[Row]) -> list[str]:
    """What a policy's page says about its rows of the clean board."""
    if not rows:
        return []
    parts = []
    if rows[0].tag == PUBLISHED:
        parts.append("<p>Rates of the paper's Table 2: other scenes and another simulator.</p>")
    for address in dict.fromkeys(web_link(row.link) for row in rows if web_link(row.link)):
        parts.append(f'<p><a href="{html.escape(address)}">{html.escape(address)}</a></p>')
    shown = [name for name in COLUMNS if name not in ("policy", "tag", "failures")]
    parts.append(_table(shown, ([dict(zip(COLUMNS, cells(row), strict=True))[name] for name in shown] for row in rows)))
    for row in rows:
        for name, rate in (row.blank or {}).items():
            said = f"{row.task}, with the {name.removeprefix('blank-')} blanked: {percent(rate)} %"
            parts.append(f"<p>{html.escape(said)}, otherwise {percent(row.rate or 0.0)} %</p>")
    failed = [(row, label, count) for row in rows for label, count in sorted((row.failures or {}).items()) if count]
    if failed:
        lines = [
            (row.task, row.protocol, label, f"{count:,}", f"{100 * count / row.episodes:.1f}" if row.episodes else "-")
            for row, label, count in failed
        ]
        parts += ["<h2>Failures</h2>", _table(("task", "protocol", "label", "episodes", "% of episodes"), lines)]
    marks = [(row.task, row.protocol, *_marks(row)) for row in rows if row.policy_digest]
    if marks:
        header = ("task", "protocol", "verified", "policy", "scenarios", "rules")
        parts += ["<h2>What was simulated</h2>", _table(header, marks)]
    return parts


def _suite_parts(rows: Sequence[SuiteRow]) -> Iterator[str]:
    """The rates of every cell of a suite as a heat map, an axis a line."""
    for row in rows:
        levels = max(len(axis.cells) for axis in row.score.axes)
        lines = []
        for axis in row.score.axes:
            rates = [cell.rate for cell in axis.cells]
            blank = ["<td></td>"] * (levels - len(rates))
            lines.append([f"<td>{html.escape(axis.name)}</td>", *map(_heat, rates), *blank, _heat(axis.mean)])
        header = ("axis", *(f"level {number}" for number in range(1, levels + 1)), "mean")
        title = (
            f"{row.suite}: {row.task}, {'adapted' if row.adapted else 'clean-trained'}, hard {share(row.score.hard)}"
        )
        yield f"<h2>{html.escape(title)}</h2>\n{_rows(header, lines)}"


def _heat(rate: float | None) -> str:
    """A rate in %, on a ground that is the darker the higher it is."""
    ground = "" if rate is None else f' style="background: rgb(34 120 60 / {0.6 * rate:.2f})"'
    return f"<td{ground}>{share(rate)}</td>"


def _marks(row: Row) -> tuple[str, ...]:
    return row.verified or "no", row.policy_digest[:12], row.scenarios_hash[:12], row.protocol_hash[:12]


def _table(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    return _rows(header, ([f"<td>{html.escape(cell)}</td>" for cell in line] for line in lines))


def _rows(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A table of cells that are HTML already."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in header)
    body = "\n".join(f"<tr>{''.join(line)}</tr>" for line in lines)
    return f"<div><table>\n<tr>{head}</tr>\n{body}\n</table></div>"
