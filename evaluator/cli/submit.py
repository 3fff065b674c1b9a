"""``rema submit``: a finished run becomes an entry of the leaderboard."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from evaluator.leaderboard.eligibility import Check

__all__ = ["submit"]


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--name", default="", help="How the policy is called on the board.  [default: as in the run]")
@click.option("--link", default="", help="Address of its paper or code.")
@click.option("--output", type=click.Path(path_type=Path), help="The entry.  [default: NAME-TASK-PROTOCOL.json]")
@click.option("--check", "only_check", is_flag=True, help="Check the run and write nothing.")
@click.option("--json", "as_json", is_flag=True, help="Print the checks and the entry's path as an object.")
def submit(run: Path, name: str, link: str, output: Path | None, only_check: bool, as_json: bool) -> None:
    """Check RUN, a finished run folder over the full test list, and pack it into an entry of a few kilobytes.

    Exit code 3: the run cannot be submitted. The message says which condition it does not meet.
    """
    from evaluator.leaderboard.submission import check_run, make_entry
    from evaluator.run.entry import encode
    from rema_data.errors import InputError
    from rema_data.storage import write_atomic

    checks = check_run(run)
    if as_json and not all(check.passed for check in checks):
        click.echo(_as_json(checks, None))
    entry = make_entry(run, name, link)
    path = None
    if not only_check:
        path = output or Path(f"{entry.policy}-{entry.task}-{entry.protocol}.json")
        content = encode(entry)
        if path.exists() and path.read_bytes() != content:
            raise InputError(f"{path} is there already", hint="choose another file with --output", path=str(path))
        write_atomic(path, content)
    if as_json:
        click.echo(_as_json(checks, path))
        return
    from evaluator.statistics import format_rate

    counts = entry.counts
    click.echo(f"{entry.policy}, {entry.task} ({entry.protocol}): {len(checks)} checks passed")
    click.echo(f"success rate {format_rate(counts.successes, counts.eligible)}, {counts.successes}/{counts.eligible}")
    if path is not None:
        click.echo(f"entry: {path} ({path.stat().st_size:,} bytes)")


def _as_json(checks: list[Check], path: Path | None) -> str:
    import dataclasses

    content = {
        "valid": all(check.passed for check in checks),
        "checks": [dataclasses.asdict(check) for check in checks],
        "entry": None if path is None else str(path),
    }
    return json.dumps(content, indent=2)
