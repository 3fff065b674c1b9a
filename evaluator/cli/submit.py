"""``rema submit``: a finished run becomes an entry of the leaderboard."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import click

from evaluator.cli.options import engine_options, json_option
from evaluator.cli.output import line, print_json

__all__ = ["submit"]


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--name", default="", help="How the policy is called on the board.  [default: as in the run]")
@click.option("--link", default="", help="Address of its paper or code.")
@click.option(
    "--output", type=click.Path(path_type=Path), help="The entry.  [default: NAME-TASK-PROTOCOL.json, or -SUITE.json]"
)
@click.option(
    "--simulator", is_flag=True, help="Declare that the policy carries a simulator or the scenario list: no rank."
)
@click.option(
    "--adapted", is_flag=True, help="Declare that it was trained on changed situations: ranked apart in a suite."
)
@engine_options
@click.option("--check", "only_check", is_flag=True, help="Check the run and write nothing.")
@json_option
def submit(
    run: Path,
    name: str,
    link: str,
    output: Path | None,
    simulator: bool,
    adapted: bool,
    only_check: bool,
    as_json: bool,
    **engine: Any,
) -> None:
    """Check RUN, a finished run folder over the full test list, and pack its actions into an entry.

    Every recorded action is simulated again (some minutes). Exit code 3: the run cannot be submitted. The message says
    which condition it does not meet.
    """
    from evaluator.cli.progress import StderrProgress
    from evaluator.leaderboard.submission import inspect_run, make_entry
    from evaluator.run.entry import encode
    from evaluator.statistics import format_rate
    from rema_data.errors import InputError
    from rema_data.storage import write_atomic

    with StderrProgress() as progress:
        inspection = inspect_run(run, **engine, progress=progress)
    checks, valid = inspection.checks, inspection.valid
    answer = {"valid": valid, "checks": [dataclasses.asdict(check) for check in checks], "entry": None}
    if as_json and not valid:
        print_json(answer)
    entry = make_entry(inspection, name, link, simulator=simulator, adapted=adapted)
    path = None
    if not only_check:
        path = output or Path(f"{entry.policy}-{entry.task}-{entry.setting}.json")
        content = encode(entry)
        if path.exists() and path.read_bytes() != content:
            raise InputError(f"{path} is there already", hint="choose another file with --output", path=str(path))
        write_atomic(path, content)
    if as_json:
        print_json({**answer, "entry": None if path is None else str(path)})
        return
    counts = entry.counts
    line(f"{entry.policy}, {entry.task} ({entry.setting}): {len(checks)} checks passed")
    line(f"success rate {format_rate(counts.successes, counts.eligible)}, {counts.successes}/{counts.eligible}")
    if path is not None:
        line(f"entry: {path} ({path.stat().st_size:,} bytes)")
