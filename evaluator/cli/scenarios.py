"""``rema scenarios``: draw a new version of the frozen scenario lists."""

from __future__ import annotations

from pathlib import Path

import click

from rema_data.schema import TASKS


@click.command(name="scenarios")
@click.argument("version")
@click.option("--task", "tasks", multiple=True, type=click.Choice(list(TASKS)), help="Only these (repeatable).")
@click.option("--test", "test_count", default=10_000, show_default=True, help="Scenarios in each test list.")
@click.option("--val", "val_count", default=2_000, show_default=True, help="Scenarios in each validation list.")
@click.option("--picker", help="Policy that picks the tools, such as tae.  [default: the reference picks]")
@click.option("--checkpoint", type=click.Path(path_type=Path), help="Its networks.")
@click.option("--device", default="cpu", show_default=True, help="Handed to the picker, such as openvino.")
@click.option(
    "--keep",
    multiple=True,
    type=click.Choice(list(TASKS)),
    help="Tasks whose present lists are named again (repeatable).",
)
@click.option("--workers", default=0, help="Processes; as many as there are cores by default.")
def scenarios(
    version: str,
    tasks: tuple[str, ...],
    test_count: int,
    val_count: int,
    picker: str | None,
    checkpoint: Path | None,
    device: str,
    keep: tuple[str, ...],
    workers: int,
) -> None:
    """Draw scenario lists under manifests/scenarios/VERSION. A list that its manifest names is never changed.

    What a picker prints is kept in the folder logs of REMA_HOME.
    """
    from evaluator.cli.progress import StderrProgress
    from evaluator.engines import default_workers
    from evaluator.policy.loading import check_checkpoint, resolve
    from evaluator.policy.shipped import shipped_checkpoint
    from evaluator.sim.bullet import require_bullet

    require_bullet()
    from evaluator.scenarios.generation import Picker, write_lists
    from rema_data.storage import rema_home

    chosen = None
    if picker is not None:
        spec = resolve(picker)
        weights = check_checkpoint(checkpoint) or shipped_checkpoint(spec.name)
        # Not beside the lists: what lies in manifests/ is frozen and published.
        chosen = Picker(spec, weights, rema_home() / "logs" / f"scenarios-{version}.log", device)
    counts = {"test": test_count, "val": val_count}
    with StderrProgress() as progress:
        wanted = tasks or tuple(task for task in TASKS if task not in keep)
        path = write_lists(version, wanted, counts, workers or default_workers(), progress, chosen, keep)
    click.echo(path)
