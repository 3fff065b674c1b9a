"""``rema leaderboard``: runs, entries and published rates in one table."""

from __future__ import annotations

from pathlib import Path

import click

from evaluator.cli.options import json_option
from rema_data.errors import MissingFileError

__all__ = ["leaderboard"]


@click.command()
@click.argument("runs", nargs=-1, type=click.Path(exists=True, path_type=Path))
@click.option(
    "--export", "form", type=click.Choice(["md", "html", "tex", "csv", "json"]), help="Print this format instead."
)
@json_option
@click.option("--entries/--no-entries", default=True, help="The entries that come with rema too.  [default: yes]")
@click.option("--published/--no-published", default=True, help="The paper's rows too.  [default: yes]")
def leaderboard(runs: tuple[Path, ...], form: str | None, as_json: bool, entries: bool, published: bool) -> None:
    """Compare RUNS in one table, with 95 % intervals and letters for those without a significant difference.

    RUNS are run folders of `rema evaluate` and entries of `rema submit`; by default all run folders below runs/.
    Only runs over the full test list have a rank. A run that is not finished, or damaged, is left out and named; where
    one is damaged, the exit code says so.
    """
    from evaluator.api import leaderboard as make_board
    from evaluator.leaderboard.export import export

    board = make_board(runs or None, entries=entries, published=published)
    if as_json or form:
        click.echo(export(board, "json" if as_json else str(form)), nl=False)
    else:
        from evaluator.cli.board import print_board

        print_board(board)
    for error in board.refused:
        if not isinstance(error, MissingFileError):
            raise error
