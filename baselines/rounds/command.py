"""``rema collect``: run a collection plan and seal a release; ``rema rounds``: carry out a recursion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evaluator.cli.options import device_option, engine_options, json_option, workers_option
from evaluator.cli.output import line, print_json, print_table, styled

if TYPE_CHECKING:
    from baselines.rounds.collect import Collected
    from baselines.rounds.estimate import Estimate

__all__ = ["collect", "rounds"]

_output_option = click.option(
    "--output", type=click.Path(path_type=Path), default=Path("releases"), show_default=True, help="Folder of releases."
)


@click.command()
@click.argument("plan", type=click.Path(path_type=Path))
@_output_option
@engine_options
@click.option("--dry-run", is_flag=True, help="Print episodes, policies, expected time and size; collect nothing.")
@click.option("--register", "publish", is_flag=True, help="Also enter the release in manifests/datasets.")
@json_option
def collect(plan: Path, output: Path, dry_run: bool, publish: bool, as_json: bool, **engine_and_workers: Any) -> None:
    """Play every episode of PLAN, a TOML file, and seal the release that it names.

    To resume a collection that was stopped or killed, run the same command again. Policies are named as for
    `rema evaluate`.
    """
    from baselines.rounds.plan import load_plan
    from evaluator.cli.progress import StderrProgress

    read = load_plan(plan)
    if dry_run:
        from baselines.rounds.collect import inherit
        from baselines.rounds.estimate import estimate

        inherit(read, output)
        with StderrProgress() as progress:
            expected = estimate(read, progress=progress, **engine_and_workers)
        _print_expected(read.about.name, expected, as_json)
        return

    from baselines.rounds.collect import collect as run

    with StderrProgress() as progress:
        done = run(read, output, progress=progress, **engine_and_workers)
    if publish:
        from rema_data.release.registry import register

        register(done.release.manifest)
    _print_done(done, as_json)


@click.command()
@click.argument("plan", type=click.Path(path_type=Path))
@_output_option
@click.option("--stages", type=click.IntRange(min=1), help="Stop after so many stages.")
@click.option("--network", metavar="FOLDER/NAME", help="Train this network of a sealed round, and nothing else.")
@workers_option
@click.option("--register", "publishing", is_flag=True, help="Then enter release and networks in the manifests.")
@device_option
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
        progress.result(f"round {stage.round}: {stage.what} {how}")

    recursion = load_recursion(plan)
    with StderrProgress() as progress:
        if network is not None:
            show(train_network(recursion, output, network, progress=progress, device=device))
            return
        done = 0
        for stage in recurse(recursion, output, progress=progress, workers=workers, device=device):
            show(stage)
            done += not stage.already
            if done == stages:
                break
    if publishing:
        publish(recursion, output)


def _print_done(done: Collected, as_json: bool) -> None:
    from rich.filesize import decimal

    manifest, counts = done.release.manifest, done.release.manifest.counts
    if as_json:
        facts = {"release": manifest.name, "path": str(done.release.path), "sha256": manifest.sha256}
        print_json({**facts, "already": done.already, "counts": counts})
        return
    what = "was sealed before, by the same plan" if done.already else "is sealed"
    line(
        f"{done.release.path} {what}: {counts['episodes']:,} episodes, {counts['steps']:,} steps, "
        f"{decimal(counts['bytes'])}"
    )
    line(f"sha256 {manifest.sha256}")


def _print_expected(name: str, expected: Sequence[Estimate], as_json: bool) -> None:
    from rich.filesize import decimal

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
    totals = {key: sum(block[key] for block in blocks) for key in ("episodes", "seconds", "bytes")}
    totals["seconds"] = round(sum(entry.seconds for entry in expected), 3)
    if as_json:
        print_json({"release": name, "blocks": blocks, "totals": totals})
        return

    def cost(block: dict[str, Any]) -> tuple[str, str, str]:
        return f"{block['episodes']:,}", _duration(block["seconds"]), decimal(block["bytes"])

    line(f"{name}: not collected")
    rows: list[Sequence[Any] | None] = []
    for block in blocks:
        *picks, last = block["policies"]
        where = (str(block["round"]), block["task"], block["split"])
        rows.append((*where, last, ", ".join(dict.fromkeys(picks)), *cost(block)))
    rows += [None, styled(("all", "", "", "", "", *cost(totals)), "bold")]
    numbers = ("episodes", "time", "size")
    print_table(("round", "task", "split", "policy", "picks", *numbers), rows, right=numbers)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    if not minutes:
        return f"{rest} s"
    return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"
