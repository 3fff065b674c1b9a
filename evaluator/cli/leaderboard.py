"""``rema leaderboard``: runs, entries and published rates in one table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from evaluator.cli.options import json_option
from evaluator.cli.output import note
from rema_data.errors import InputError, MissingFileError

if TYPE_CHECKING:
    from evaluator.leaderboard import Board

__all__ = ["leaderboard"]


@click.command()
@click.argument("runs", nargs=-1, type=click.Path(exists=True, path_type=Path))
@click.option(
    "--export",
    "form",
    type=click.Choice(["md", "html", "tex", "csv", "json", "site"]),
    help="Print this format instead; site: see --output.",
)
@click.option("--output", type=click.Path(path_type=Path), help="New folder of --export site: pages for a web server.")
@click.option("--suite", metavar="hard-v1", help="The table of a generalisation suite, by axis.")
@json_option
@click.option("--entries/--no-entries", default=True, help="The entries that come with rema too.  [default: yes]")
@click.option("--published/--no-published", default=True, help="The paper's rows too.  [default: yes]")
@click.option("--verify", is_flag=True, help="Simulate the actions of everything that is not verified (minutes each).")
@click.option(
    "--record",
    is_flag=True,
    help="Verify each of RUNS, entries in manifests/leaderboard, and write its record.",
)
def leaderboard(
    runs: tuple[Path, ...],
    form: str | None,
    output: Path | None,
    suite: str | None,
    as_json: bool,
    entries: bool,
    published: bool,
    verify: bool,
    record: bool,
) -> None:
    """Compare RUNS in one table, with 95 % intervals and letters for those without a significant difference.

    RUNS are run folders of `rema evaluate` and entries of `rema submit`; by default all run folders below runs/.
    Only runs over the full test list have a rank, and only where their actions were simulated: on this machine, or by
    the CI of rema (verification records). The others stand apart. A run that is not finished, or damaged, is left out
    and named; where one is damaged, the exit code says so.
    """
    from evaluator.api import leaderboard as make_board
    from evaluator.cli.progress import StderrProgress
    from evaluator.leaderboard.export import export

    if (form == "site") != (output is not None) or (output is not None and (suite or as_json)):
        raise InputError(
            "a site is written into a folder, and nothing else is",
            hint="rema leaderboard --export site --output FOLDER",
        )
    if record:
        _record(runs)
    with StderrProgress() as progress:
        board = make_board(runs or None, entries=entries, published=published, verify=verify, progress=progress)
    if output is not None:
        from evaluator.leaderboard.site import write_site

        pages = write_site(board, output)
        note(f"{output}: {pages} pages, index.html first")
    elif suite is not None:
        _print_suite(board, suite, "json" if as_json else form)
    elif as_json or form:
        click.echo(export(board, "json" if as_json else str(form)), nl=False)
    else:
        from evaluator.cli.board import print_board

        print_board(board)
    for error in board.refused:
        if not isinstance(error, MissingFileError):
            raise error


def _print_suite(board: Board, suite: str, form: str | None) -> None:
    from evaluator.cli.board import print_suite
    from evaluator.leaderboard.suite_tables import SUITE_FORMATS, suite_remarks, suite_tables

    if form is None:
        print_suite(suite_tables(board, suite), suite_remarks(board, suite))
    elif form in SUITE_FORMATS:
        click.echo(SUITE_FORMATS[form](board, suite), nl=False)
    else:
        raise InputError(f"a suite is not shown as {form}", hint=f"choose one of: {', '.join(SUITE_FORMATS)}")


def _record(entries: tuple[Path, ...]) -> None:
    from evaluator.cli.progress import StderrProgress
    from evaluator.leaderboard.verification import write_record
    from evaluator.run.reading import read_run

    if not entries:
        raise InputError("there is nothing to record", hint="rema leaderboard --record manifests/leaderboard/NAME.json")
    for entry in entries:
        with StderrProgress() as progress:
            path = write_record(read_run(entry), progress)
        note(f"record: {path}")
