"""``rema collect``: run a collection plan and seal a release; ``rema rounds``: carry out a recursion."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evaluator.cli.engine_options import engine_options

if TYPE_CHECKING:
    from baselines.rounds.collect import Collected
    from baselines.rounds.estimate import Estimate

__all__ = ["collect", "rounds"]


_plan = click.argument("plan", type=click.Path(path_type=Path))
_output = click.option(
    "--output", type=click.Path(path_type=Path), default=Path("releases"), show_default=True, help="Folder of releases."
)


@click.command()
@_plan
@_output
@engine_options
@click.option("--dry-run", is_flag=True, help="Print episodes, policies, expected time and size; collect nothing.")
@click.option("--register", "publish", is_flag=True, help="Also enter the release in manifests/datasets.")
@click.option("--json", "as_json", is_flag=True, help="Print one object.")
def collect(plan: Path, output: Path, dry_run: bool, publish: bool, as_json: bool, **engine: Any) -> None:
    """Play every episode of PLAN, a TOML file, and seal the release that it names.

    To resume a collection that was stopped or killed, run the same command again. Policies are named as for
    `rema evaluate`.
    """
    from baselines.rounds.plan import load_plan
    from evaluator.cli.progress import StderrProgress

    planned = load_plan(plan)
    if dry_run:
        from baselines.rounds.collect import inherit
        from baselines.rounds.estimate import estimate

        inherit(planned, output)
        with StderrProgress() as progress:
            expected = estimate(planned, progress=progress, **engine)
        _print_expected(planned.about.name, expected, as_json)
        return

    from baselines.rounds.collect import collect as run

    with StderrProgress() as progress:
        done = run(planned, output, progress=progress, **engine)
    if publish:
        from rema_data.release.registry import register

        register(done.release.manifest)
    _print_done(done, as_json)


@click.command()
@_plan
@_output
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

    planned = load_recursion(plan)
    with StderrProgress() as progress:
        if network is not None:
            show(train_network(planned, output, network, progress=progress, device=device))
            return
        done = 0
        for stage in recurse(planned, output, progress=progress, workers=workers, device=device):
            show(stage)
            done += not stage.already
            if done == stages:
                break
    if publishing:
        publish(planned, output)


def _print_done(done: Collected, as_json: bool) -> None:
    from rich.filesize import decimal

    manifest, counts = done.release.manifest, done.release.manifest.counts
    if as_json:
        facts = {"release": manifest.name, "path": str(done.release.path), "sha256": manifest.sha256}
        click.echo(json.dumps({**facts, "already": done.already, "counts": counts}, indent=2))
        return
    what = "was sealed before, by the same plan" if done.already else "is sealed"
    click.echo(
        f"{done.release.path} {what}: {counts['episodes']:,} episodes, {counts['steps']:,} steps, "
        f"{decimal(counts['bytes'])}"
    )
    click.echo(f"sha256 {manifest.sha256}")


def _print_expected(name: str, expected: Sequence[Estimate], as_json: bool) -> None:
    rows = [
        {
            **entry.block.key._asdict(),
            "episodes": entry.block.episodes,
            "policies": [use.spec.name for use in entry.block.policies],
            "seconds": round(entry.seconds, 3),
            "bytes": entry.bytes,
        }
        for entry in expected
    ]
    totals = {key: sum(row[key] for row in rows) for key in ("episodes", "seconds", "bytes")}
    if as_json:
        totals["seconds"] = round(totals["seconds"], 3)
        click.echo(json.dumps({"release": name, "blocks": rows, "totals": totals}, indent=2))
        return
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
    for row in rows:
        *picks, last = row["policies"]
        where = (str(row["round"]), row["task"], row["split"])
        table.add_row(*where, last, ", ".join(dict.fromkeys(picks)), *_cost(row, decimal))
    table.add_section()
    table.add_row("all", "", "", "", "", *_cost(totals, decimal), style="bold")
    Console().print(table)


def _cost(row: dict[str, Any], size: Callable[[int], str]) -> tuple[str, str, str]:
    return f"{row['episodes']:,}", _duration(row["seconds"]), size(row["bytes"])


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    if not minutes:
        return f"{rest} s"
    return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"
