"""``rema rounds``: carry out a recursion."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from baselines.rounds.recursion import Stage
    from baselines.train.loop import Report
    from evaluator.cli.progress import StderrProgress

__all__ = ["rounds"]


@click.command()
@click.argument("plan", type=click.Path(path_type=Path))
@click.option(
    "--output", type=click.Path(path_type=Path), default=Path("releases"), show_default=True, help="Folder of releases."
)
@click.option("--stages", type=click.IntRange(min=1), help="Stop after so many stages.")
@click.option("--network", metavar="FOLDER/NAME", help="Train this network of a sealed round, and nothing else.")
@click.option("--workers", type=click.IntRange(min=1), help="Simulation processes.  [default: one a core]")
@click.option("--register", "publish", is_flag=True, help="Then enter release and networks in the manifests.")
@click.option("--device", default="cpu", show_default=True, help="Of the trainings.")
def rounds(
    plan: Path,
    output: Path,
    stages: int | None,
    network: str | None,
    workers: int | None,
    publish: bool,
    device: str,
) -> None:
    """Collect, train, and collect with what was trained, as PLAN says, a TOML file.

    Every stage leaves a sealed release or a checkpoint, and is skipped when that is there: run the same command again
    after any interruption.
    """
    from baselines.rounds.recursion import recurse, train_network
    from baselines.rounds.recursion_plan import load_recursion
    from evaluator.cli.progress import StderrProgress

    wanted = load_recursion(plan)
    with StderrProgress() as progress:
        if network is not None:
            train_network(wanted, output, network, _Watcher(progress), device)
            return
        recurse(wanted, output, _Watcher(progress), stages=stages, workers=workers, device=device)
    if publish:
        from baselines.rounds.recursion import publish as enter

        enter(wanted, output)


class _Watcher:
    """Shows a recursion on stderr."""

    def __init__(self, progress: StderrProgress) -> None:
        self.sink = progress

    def training(self, what: str, updates: int) -> Report:
        from baselines.train.command import reporter

        return reporter(self.sink, what, updates)

    def done(self, stage: Stage) -> None:
        how = "was there" if stage.already else f"done in {stage.seconds:.0f} s"
        click.echo(f"round {stage.round}: {stage.what} {how}")
