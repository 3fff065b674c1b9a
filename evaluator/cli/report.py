"""``rema report``: one page about a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from evaluator.cli.options import json_option, policy_options
from evaluator.cli.output import line, note, print_json

__all__ = ["report"]

_MEGABYTE = 1_000_000


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--output", type=click.Path(path_type=Path), help="HTML file.  [default: report.html in the run folder]")
@click.option(
    "--per-label", type=click.IntRange(0, 50), default=3, show_default=True, help="Episodes shown of every label."
)
@click.option("--policy", metavar="POLICY", help="The run's policy: adds its score maps and its calibration.")
@policy_options
@click.option("--scored", type=click.IntRange(0, 10_000), default=200, show_default=True, help="Episodes to calibrate.")
@click.option("--limit-mb", type=click.FloatRange(min=0.5), default=15.0, show_default=True, help="Size of the page.")
@json_option
def report(
    run: Path,
    output: Path | None,
    policy: str | None,
    checkpoint: Path | None,
    limit_mb: float,
    as_json: bool,
    **options: Any,
) -> None:
    """Write one self-contained HTML page about RUN (a run folder of `rema evaluate`).

    It has the rate, the failures, success by group and by place, some episodes of every label with pictures and short
    animations, timings and provenance. The episodes are played again from their recorded actions, which needs no
    policy. With --policy the page also has the policy's score maps, if it can give them.
    """
    # Imported here, so that a mistyped option is answered at once.
    from evaluator.cli.progress import StderrProgress
    from evaluator.cli.quiet import import_pybullet
    from evaluator.policy.loading import resolve

    import_pybullet()
    from evaluator.report import ReportOptions, write_report
    from rema_data.errors import InputError

    for option, value in (("--checkpoint", checkpoint), ("--sandbox", options["sandbox"])):
        if value is not None and policy is None:
            raise InputError(f"{option} belongs to a policy", hint=f"name it with --policy, or drop {option}")
    spec = None if policy is None else resolve(policy)
    shown = ReportOptions(policy=spec, checkpoint=checkpoint, limit_bytes=int(limit_mb * _MEGABYTE), **options)
    with StderrProgress() as progress:
        written = write_report(run, output, shown, progress)
    if as_json:
        print_json(
            {
                "file": str(written.path),
                "bytes": written.size,
                "episodes_shown": written.shown,
                "played_again": dict(written.agreement),
                "episodes_scored": written.scored,
                "pictures_left_out": written.left_out,
            }
        )
        return
    line(f"{written.path}: {written.size / _MEGABYTE:.1f} MB, {written.shown} episodes")
    different = written.agreement.get("different", 0)
    if different:
        note(f"{different} of them ended differently when they were played again; the page says which")
