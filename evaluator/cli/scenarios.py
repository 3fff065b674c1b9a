"""``rema scenarios``: draw a new version of the frozen scenario lists."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from evaluator.cli.options import checkpoint_option, device_option, tasks_option, workers_option
from evaluator.cli.output import line
from evaluator.protocol import SCENARIOS
from rema_data.schema import TASKS

if TYPE_CHECKING:
    from evaluator.scenarios.policy_picks import Picker

__all__ = ["scenarios"]


@click.command(name="scenarios")
@click.argument("version")
@tasks_option
@click.option("--test", "test_count", default=SCENARIOS["test"], show_default=True, help="Scenarios in each test list.")
@click.option(
    "--val", "val_count", default=SCENARIOS["val"], show_default=True, help="Scenarios in each validation list."
)
@click.option("--picker", help="Policy that picks the tools, such as tae.  [default: the reference picks]")
@checkpoint_option
@device_option
@click.option(
    "--keep",
    multiple=True,
    type=click.Choice(list(TASKS)),
    help="Tasks whose present lists are named again (repeatable).",
)
@click.option("--suite", "is_suite", is_flag=True, help="Draw the cells of a generalisation suite of that name.")
@click.option("--cell", "cell_counts", nargs=2, type=int, metavar="TEST VAL", help="Scenarios of a cell of a suite.")
@workers_option
def scenarios(
    version: str,
    tasks: tuple[str, ...] | None,
    test_count: int,
    val_count: int,
    picker: str | None,
    checkpoint: Path | None,
    device: str,
    keep: tuple[str, ...],
    is_suite: bool,
    cell_counts: tuple[int, int] | None,
    workers: int | None,
) -> None:
    """Draw scenario lists under manifests/scenarios/VERSION. A list that its manifest names is never changed.

    What a picker prints is kept in the folder logs of REMA_HOME.
    """
    from contextlib import nullcontext

    from evaluator.cli.progress import StderrProgress
    from evaluator.engines import default_workers
    from evaluator.engines.child import process_pool
    from evaluator.policy.loading import resolve, weights_of
    from evaluator.sim.bullet import require_bullet

    require_bullet()
    from evaluator.rollout.picks import open_picker
    from evaluator.scenarios.generation import write_lists
    from rema_data.storage import rema_home

    processes = workers or default_workers()
    if is_suite:
        from evaluator.run.environment import source_digest
        from evaluator.scenarios.suite import CELL, draw_suite
        from evaluator.sim import DECIDES

        size = dict(zip(CELL, cell_counts, strict=True)) if cell_counts else None
        code = source_digest(*DECIDES, "evaluator.scenarios")
        with StderrProgress() as progress, process_pool(processes) as pool:
            manifest = draw_suite(version, pool, tasks or tuple(TASKS), size, identity=code, progress=progress)
        line(str(manifest))
        return
    opened: AbstractContextManager[Picker | None] = nullcontext()
    if picker is not None:
        spec = resolve(picker)
        # Not beside the lists: what lies in manifests/ is frozen and published.
        log = rema_home() / "logs" / f"scenarios-{version}.log"
        opened = open_picker(spec, weights_of(spec, checkpoint), device, log, processes)
    counts = {"test": test_count, "val": val_count}
    drawn = tasks or tuple(task for task in TASKS if task not in keep)
    with StderrProgress() as progress, process_pool(processes) as pool, opened as chosen:
        manifest = write_lists(version, pool, drawn, counts, progress=progress, picker=chosen, keep=keep)
    line(str(manifest))
