"""``rema leaderboard``: runs and published rates in one table."""

from __future__ import annotations

from pathlib import Path

import click

__all__ = ["leaderboard"]


@click.command()
@click.argument("runs", nargs=-1, type=click.Path(path_type=Path))
@click.option("--export", "form", type=click.Choice(["md", "csv", "json"]), help="Print this format instead.")
@click.option("--json", "as_json", is_flag=True, help="The same as --export json.")
@click.option("--published/--no-published", default=True, help="The paper's rows too.  [default: yes]")
def leaderboard(runs: tuple[Path, ...], form: str | None, as_json: bool, published: bool) -> None:
    """Compare RUNS (run folders of `rema evaluate`; default: all below runs/) with 95 % intervals."""
    from evaluator.export import export
    from evaluator.leaderboard import find_runs
    from evaluator.leaderboard import leaderboard as make_rows

    rows = make_rows(runs or find_runs(Path("runs")), published)
    if as_json or form:
        click.echo(export(rows, "json" if as_json or form is None else form), nl=False)
    else:
        from evaluator.cli.board import print_board

        print_board(rows)
