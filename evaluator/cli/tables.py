"""Tables that the verbs print."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from rich import box
from rich.console import JustifyMethod
from rich.table import Table
from rich.text import Text

__all__ = ["make_table"]


def make_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[str | Text]] = (),
    *,
    title: str | None = None,
    right: Collection[str] = (),
    no_wrap: Collection[str] = (),
) -> Table:
    """A table for 80 characters.

    Parameters
    ----------
    columns : sequence of str
    rows : iterable of sequence of str or Text
        Text is printed as it is: square brackets mean nothing.
    title : str, optional
    right : collection of str
        Columns of numbers, aligned to the right.
    no_wrap : collection of str
        Columns whose cells stay on one line; those of the others are folded.
    """
    table = Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0)
    )
    for name in columns:
        justified: JustifyMethod = "right" if name in right else "left"
        table.add_column(name, justify=justified, no_wrap=name in no_wrap, overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in row))
    return table
