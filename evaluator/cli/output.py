"""What every verb prints: tables and colours on a terminal; plain text, one record a line, into a pipe or a file.

Nothing is wrapped here, whatever the width: a terminal wraps a long line itself, so that a path, a digest or a command
is whole when it is copied. Only this module makes a rich console.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    # rich is imported where it is needed: `rema --help` and errors do without it.
    from rich.console import Console
    from rich.text import Text

__all__ = [
    "console",
    "line",
    "note",
    "plain",
    "print_answer",
    "print_facts",
    "print_json",
    "print_table",
    "styled",
    "terminal_width",
]

_NO_LIMIT = 1_000_000
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


def _visible(text: str) -> str:
    """The text with control characters as escapes: a terminal obeys them."""
    return _CONTROL.sub(lambda found: ascii(found[0])[1:-1], text)


def plain(text: str, style: str = "") -> Text:
    """The text as it is: square brackets mean nothing, control characters are escaped."""
    from rich.text import Text

    return Text(_visible(text), style=style)


def console(*, err: bool = False) -> Console:
    """A console on stdout or stderr, without colour where that is not a terminal."""
    from rich.console import Console

    stream = sys.stderr if err else sys.stdout
    return Console(stderr=err, force_terminal=stream is not None and stream.isatty(), highlight=False)


def terminal_width() -> int:
    """Characters in a line of stdout; a pipe or a file takes any number."""
    out = console()
    return out.width if out.is_terminal else _NO_LIMIT


def line(text: str | Text, style: str = "") -> None:
    """Print a line on stdout."""
    console().print(plain(text, style) if isinstance(text, str) else text, soft_wrap=True)


def note(text: str) -> None:
    """Print a line on stderr."""
    click.echo(_visible(text), err=True)


def print_json(content: Any) -> None:
    """Print one object, which is then alone on stdout."""
    click.echo(json.dumps(content, indent=2))


def print_answer(result: Any, as_json: bool, print_text: Callable[[Any], None]) -> None:
    """Print a result: its ``to_dict()`` as one object alone, or as text for people."""
    if as_json:
        print_json(result.to_dict())
    else:
        print_text(result)


def print_facts(facts: Iterable[tuple[str, str | Text]]) -> None:
    """Print named values, one a line."""
    from rich.text import Text

    facts = list(facts)
    width = max(len(name) for name, _ in facts)
    for name, value in facts:
        line(Text.assemble((f"{name:>{width}}  ", "dim"), plain(value) if isinstance(value, str) else value))


def styled(row: Iterable[str], style: str) -> list[Text]:
    """The cells of a row in one style."""
    return [plain(cell, style) for cell in row]


def print_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[str | Text] | None],
    *,
    title: str = "",
    right: Collection[str] = (),
) -> None:
    """Print a table, every row on one line; ``right`` names the columns that are aligned to the right.

    A table whose titles are all empty has no header. A row that is None is a gap between two rows, on a terminal.
    """
    from rich import box
    from rich.table import Table
    from rich.text import Text

    out = console()
    frame, gap = (box.SIMPLE_HEAD, 1) if out.is_terminal else (None, 2)
    table = Table(box=frame, padding=(0, gap, 0, 0), show_edge=False, pad_edge=False, show_header=any(columns))
    for name in columns:
        table.add_column(name, justify="right" if name in right else "left", no_wrap=True)
    for row in rows:
        if row is None:
            table.add_section()
            continue
        cells = [plain(cell) if isinstance(cell, str) else cell for cell in row]
        table.add_row(*(Text(" ").join(cell.split("\n")) for cell in cells))
    if title:
        line(title, "bold")
    for segments in out.render_lines(table, out.options.update(width=_NO_LIMIT), pad=False):
        text = Text.assemble(*((segment.text, segment.style or "") for segment in segments))
        text.rstrip()
        line(text)
    if out.is_terminal:
        line("")
