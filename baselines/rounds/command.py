"""``rema collect``: run a collection plan and seal a release."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evaluator.cli.engine_options import engine_options

if TYPE_CHECKING:
    from baselines.rounds.collect import Collected
    from baselines.rounds.estimate import Estimate
    from baselines.rounds.planned import BlockPlan

__all__ = ["collect"]


@click.command()
@click.argument("plan", type=click.Path(path_type=Path))
@click.option(
    "--output", type=click.Path(path_type=Path), default=Path("releases"), show_default=True, help="Folder of releases."
)
@engine_options
@click.option("--dry-run", is_flag=True, help="Print episodes, policies, expected time and size; collect nothing.")
@click.option("--register", "publish", is_flag=True, help="Also enter the release in manifests/datasets.")
@click.option("--json", "as_json", is_flag=True, help="Print one object.")
def collect(
    plan: Path,
    output: Path,
    workers: int | None,
    engine: str,
    address: str | None,
    dry_run: bool,
    publish: bool,
    as_json: bool,
) -> None:
    """Play every episode of PLAN, a TOML file, and seal the release that it names.

    A collection that was stopped, or killed, goes on where it was: run the same command again. A policy in the plan is
    whatever `rema evaluate` takes.
    """
    from baselines.rounds.plan import load_plan
    from evaluator.cli.progress import StderrProgress

    wanted = load_plan(plan)
    if dry_run:
        from baselines.rounds.collect import inherit
        from baselines.rounds.estimate import estimate

        inherit(wanted, output)
        with StderrProgress() as progress:
            expected = estimate(wanted, engine=engine, workers=workers, address=address, progress=progress)
        _print_expected(wanted.about.name, expected, as_json)
        return

    from baselines.rounds.collect import collect as run

    with StderrProgress() as progress:
        done = run(wanted, output, engine=engine, workers=workers, address=address, progress=progress)
    if publish:
        from rema_data.release.registry import register

        register(done.release.manifest)
    _print_done(done, as_json)


def _print_done(done: Collected, as_json: bool) -> None:
    manifest = done.release.manifest
    if as_json:
        facts = {"release": manifest.name, "path": str(done.release.path), "sha256": manifest.sha256}
        click.echo(json.dumps({**facts, "already": done.already, "counts": manifest.counts}, indent=2))
        return
    counts = manifest.counts
    what = "was sealed before, by the same plan" if done.already else "is sealed"
    click.echo(
        f"{done.release.path} {what}: {counts['episodes']:,} episodes, {counts['steps']:,} steps, "
        f"{_size(counts['bytes'])}"
    )
    click.echo(f"sha256 {manifest.sha256}")


def _policies(block: BlockPlan) -> list[str]:
    return [use.spec.name for use in block.policies]


def _print_expected(name: str, expected: Sequence[Estimate], as_json: bool) -> None:
    totals = {
        "episodes": sum(entry.block.episodes for entry in expected),
        "seconds": round(sum(entry.seconds for entry in expected), 3),
        "bytes": sum(entry.bytes for entry in expected),
    }
    if not as_json:
        _print_table(name, expected, totals)
        return
    blocks = [
        {
            **entry.block.key._asdict(),
            "episodes": entry.block.episodes,
            "policies": _policies(entry.block),
            "seconds": round(entry.seconds, 3),
            "bytes": entry.bytes,
        }
        for entry in expected
    ]
    click.echo(json.dumps({"release": name, "blocks": blocks, "totals": totals}, indent=2))


def _print_table(name: str, expected: Sequence[Estimate], totals: dict[str, Any]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(
        title=f"{name}: not collected",
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    for column in ("round", "task", "split", "policy", "picks", "episodes", "time", "size"):
        right = column in ("episodes", "time", "size")
        names = column in ("policy", "picks")
        table.add_column(column, justify="right" if right else "left", no_wrap=not names, overflow="fold")
    for entry in expected:
        block = entry.block
        *picks, last = _policies(block)
        where = (str(block.key.round), block.key.task, block.key.split)
        cost = (f"{block.episodes:,}", _duration(entry.seconds), _size(entry.bytes))
        table.add_row(*where, last, ", ".join(dict.fromkeys(picks)), *cost)
    table.add_section()
    cost = (f"{totals['episodes']:,}", _duration(totals["seconds"]), _size(totals["bytes"]))
    table.add_row("all", "", "", "", "", *cost, style="bold")
    Console().print(table)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    if not minutes:
        return f"{rest} s"
    return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e6 else f"{count / 1e3:.0f} kB"
