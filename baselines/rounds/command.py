"""``rema collect``: run a collection plan and seal a release; ``rema rounds``: carry out a recursion."""

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

__all__ = ["collect", "rounds"]


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

    To resume a collection that was stopped or killed, run the same command again. Policies are named as for
    `rema evaluate`.
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


@click.command()
@click.argument("plan", type=click.Path(path_type=Path))
@click.option(
    "--output", type=click.Path(path_type=Path), default=Path("releases"), show_default=True, help="Folder of releases."
)
@click.option("--stages", type=click.IntRange(min=1), help="Stop after so many stages.")
@click.option("--network", metavar="FOLDER/NAME", help="Train this network of a sealed round, and nothing else.")
@click.option("--workers", type=click.IntRange(min=1), help="Simulation processes.  [default: one a core]")
@click.option("--register", "publishing", is_flag=True, help="Then enter release and networks in the manifests.")
@click.option("--device", default="cpu", show_default=True, help="Of the trainings.")
def rounds(
    plan: Path,
    output: Path,
    stages: int | None,
    network: str | None,
    workers: int | None,
    publishing: bool,
    device: str,
) -> None:
    """Collect, train, and collect with what was trained, as PLAN says, a TOML file.

    Every stage leaves a sealed release or a checkpoint, and is skipped when that is there: run the same command again
    after any interruption.
    """
    from baselines.rounds.recursion import Stage, publish, recurse, train_network
    from baselines.rounds.recursion_plan import load_recursion
    from evaluator.cli.progress import StderrProgress

    def show(stage: Stage) -> None:
        how = "was there" if stage.already else f"done in {stage.seconds:.0f} s"
        click.echo(f"round {stage.round}: {stage.what} {how}")

    wanted = load_recursion(plan)
    with StderrProgress() as progress:
        if network is not None:
            show(train_network(wanted, output, network, progress=progress, device=device))
            return
        left = stages
        for stage in recurse(wanted, output, progress=progress, workers=workers, device=device):
            show(stage)
            if left is not None and not stage.already:
                left -= 1
            if left == 0:
                break
    if publishing:
        publish(wanted, output)


def _print_done(done: Collected, as_json: bool) -> None:
    from rich.filesize import decimal

    manifest = done.release.manifest
    if as_json:
        facts = {"release": manifest.name, "path": str(done.release.path), "sha256": manifest.sha256}
        click.echo(json.dumps({**facts, "already": done.already, "counts": manifest.counts}, indent=2))
        return
    counts = manifest.counts
    what = "was sealed before, by the same plan" if done.already else "is sealed"
    click.echo(
        f"{done.release.path} {what}: {counts['episodes']:,} episodes, {counts['steps']:,} steps, "
        f"{decimal(counts['bytes'])}"
    )
    click.echo(f"sha256 {manifest.sha256}")


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
            "policies": [use.spec.name for use in entry.block.policies],
            "seconds": round(entry.seconds, 3),
            "bytes": entry.bytes,
        }
        for entry in expected
    ]
    click.echo(json.dumps({"release": name, "blocks": blocks, "totals": totals}, indent=2))


def _print_table(name: str, expected: Sequence[Estimate], totals: dict[str, Any]) -> None:
    from rich import box
    from rich.console import Console
    from rich.filesize import decimal
    from rich.table import Table

    click.echo(f"{name}: not collected")
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for column in ("round", "task", "split", "policy", "picks", "episodes", "time", "size"):
        right = column in ("episodes", "time", "size")
        names = column in ("policy", "picks")
        table.add_column(column, justify="right" if right else "left", no_wrap=not names, overflow="fold")
    for entry in expected:
        block = entry.block
        *picks, last = (use.spec.name for use in block.policies)
        where = (str(block.key.round), block.key.task, block.key.split)
        cost = (f"{block.episodes:,}", _duration(entry.seconds), decimal(entry.bytes))
        table.add_row(*where, last, ", ".join(dict.fromkeys(picks)), *cost)
    table.add_section()
    cost = (f"{totals['episodes']:,}", _duration(totals["seconds"]), decimal(totals["bytes"]))
    table.add_row("all", "", "", "", "", *cost, style="bold")
    Console().print(table)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    if not minutes:
        return f"{rest} s"
    return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"
