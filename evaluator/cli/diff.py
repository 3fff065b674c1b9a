"""``rema diff``: what differs between two releases."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from evaluator.cli.options import json_option
from evaluator.cli.output import line, print_answer, print_table
from rema_data.errors import IntegrityError

if TYPE_CHECKING:
    from rema_data.diff import ReleaseDiff

__all__ = ["diff"]


@click.command()
@click.argument("a")
@click.argument("b")
@json_option
@click.pass_context
def diff(ctx: click.Context, a: str, b: str, as_json: bool) -> None:
    """Compare release A with release B: blocks, rows and columns; exit code 6 where they differ.

    A and B are names or folders. Blocks with the same bytes are equal and not read. Releases that
    differ only in their description are equal.
    """
    from evaluator.cli.progress import StderrProgress
    from rema_data.diff import diff_releases
    from rema_data.release.folder import find_release

    sides = find_release(a), find_release(b)
    with StderrProgress() as progress:
        found = diff_releases(*sides, progress)
    print_answer(found, as_json, _print)
    if not found.equal:
        ctx.exit(IntegrityError.exit_code)


def _print(found: ReleaseDiff) -> None:
    for side, name, sha256 in zip("AB", (found.a, found.b), found.sha256, strict=True):
        line(f"{side}: {name} ({sha256[:12]})", "bold")
    counts = ("episodes A", "episodes B", "steps A", "steps B")
    blocks = [
        (block.block, block.state, *(f"{count:,}" for count in (*block.episodes, *block.steps)))
        for block in found.blocks
    ]
    if blocks:
        print_table(("block", "", *counts), blocks, right=counts)
    numbers = ("only in A", "only in B", "changed")
    rows = [
        (
            block.block,
            table.table,
            *(f"{count:,}" for count in (table.only_a, table.only_b, table.changed)),
            ", ".join(f"{name} {count:,}" for name, count in table.columns.items()),
        )
        for block in found.blocks
        for table in block.tables
    ]
    if rows:
        print_table(("block", "rows of", *numbers, "rows that differ, by column"), rows, right=numbers)
    for fix in dict.fromkeys(block.fix for block in found.blocks if block.fix):
        line(f"to compare what is not here: {fix}", "yellow")
    if found.fields:
        line(f"described differently: {', '.join(found.fields)}")
    line(f"{found.equal_blocks:,} blocks are equal", "green" if found.equal else "")
