"""What every verb prints: tables and colours on a terminal; plain text, one record a line, into a pipe or a file.

Nothing is wrapped or cut here, whatever the width: a terminal wraps a long line itself, so that a path, a digest or a
command is whole when it is copied. A table that is wider than the terminal leaves columns out, or becomes records. Only
this module makes a rich console.
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
_GAP = 2
"""Blanks between two columns."""
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
    header: bool = True,
    optional: Sequence[str] = (),
) -> set[str]:
    """Print a table, every row on one line; return the columns that found no room.

    A terminal that is too narrow does without the ``optional`` columns, the first one first; where that is not enough,
    every row becomes a record of all its values, one a line. So no value is ever cut.

    Parameters
    ----------
    columns : sequence of str
        Their names; a column without a name has none in a record either.
    rows : iterable
        One sequence of cells a row; None is a gap between two rows, on a terminal.
    right : collection of str
        Names of the columns that are aligned to the right.
    header : bool
        Whether the table begins with the names.
    """
    from rich.text import Text

    names = [" ".join(name.split("\n")) for name in columns]
    table = [
        None
        if row is None
        else [Text(" ").join((plain(cell) if isinstance(cell, str) else cell).split("\n")) for cell in row]
        for row in rows
    ]
    header = header and any(names)
    widths = [
        max([len(name) if header else 0, *(row[at].cell_len for row in table if row is not None)])
        for at, name in enumerate(names)
    ]
    hidden: set[str] = set()

    def too_wide() -> bool:
        shown = [width + _GAP for name, width in zip(names, widths, strict=True) if name not in hidden]
        return sum(shown) - _GAP > terminal_width()

    for name in optional:
        if name in names and too_wide():
            hidden.add(name)
    if title:
        line(title, "bold")
    if too_wide():
        _print_records(names, table)
        return set()
    places = [at for at, name in enumerate(names) if name not in hidden]
    shown = [None if row is None else [row[at] for at in places] for row in table]
    _print_grid([names[at] for at in places], shown, {" ".join(name.split("\n")) for name in right}, header)
    return hidden


def _print_grid(
    names: Sequence[str], rows: Sequence[Sequence[Text] | None], right: Collection[str], header: bool
) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    out = console()
    frame, gap = (box.SIMPLE_HEAD, _GAP - 1) if out.is_terminal else (None, _GAP)
    grid = Table(box=frame, padding=(0, gap, 0, 0), show_edge=False, pad_edge=False, show_header=header)
    for name in names:
        grid.add_column(name, justify="right" if name in right else "left", no_wrap=True)
    for row in rows:
        if row is None:
            grid.add_section()
        else:
            grid.add_row(*row)
    for segments in out.render_lines(grid, out.options.update(width=_NO_LIMIT), pad=False):
        text = Text.assemble(*((segment.text, segment.style or "") for segment in segments))
        text.rstrip()
        line(text)
    if out.is_terminal:
        line("")


def _print_records(names: Sequence[str], rows: Iterable[Sequence[Text] | None]) -> None:
    """One value a line beside its name; below it where both have no room, so that the terminal does not break it."""
    from rich.text import Text

    wide = max(map(len, names))
    for row in rows:
        for name, cell in zip(names, row or (), strict=row is not None):
            if not name:
                line(cell)
            elif cell.cell_len and wide + _GAP + cell.cell_len > terminal_width():
                line(name, "dim")
                line(cell)
            elif cell.cell_len:
                line(Text.assemble((f"{name:<{wide}}", "dim"), " " * _GAP, cell))
        if row:
            line("")
