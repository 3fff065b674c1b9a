"""``rema check``: what an evaluation would refuse, in seconds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rema_data.errors import SubmissionError
from rema_data.schema import TASKS

if TYPE_CHECKING:
    from evaluator.policy.check_report import PolicyReport

__all__ = ["check"]

_STYLES = {"ok": "green", "warning": "yellow", "refused": "bold red"}


@click.command()
@click.argument("policy")
@click.option("--task", "tasks", multiple=True, type=click.Choice(list(TASKS)), help="Only these.  [default: all]")
@click.option("--checkpoint", type=click.Path(path_type=Path), help="Weights, handed to the policy.")
@click.option("--device", default="cpu", show_default=True, help="Handed to the policy, such as cuda:0.")
@click.option("--sandbox", metavar="CMD", help="Wrapper of the policy's process, as for `rema evaluate`.")
@click.option("--json", "as_json", is_flag=True, help="Print one object.")
@click.pass_context
def check(
    ctx: click.Context,
    policy: str,
    tasks: tuple[str, ...],
    checkpoint: Path | None,
    device: str,
    sandbox: str | None,
    as_json: bool,
) -> None:
    """Load POLICY in the sandbox and ask it some questions of every task: what would be refused, and how to fix it.

    POLICY is my_policy.py, my_policy.py:ClassName, or the name of an installed policy. The questions are validation
    scenarios at every step. They are asked again in another process, order and batch size, and timed.

    Exit code 3: `rema evaluate` or `rema submit` would refuse the policy.
    """
    # Imported here, so that a mistyped option is answered at once.
    from evaluator.cli.progress import StderrProgress
    from evaluator.policy.check import check_policy

    with StderrProgress() as progress:
        report = check_policy(
            policy, task=tasks, checkpoint=checkpoint, device=device, sandbox=sandbox, progress=progress
        )
    if as_json:
        click.echo(json.dumps(report.to_dict(), indent=2))
    else:
        _print(report)
    if not report.ok:
        ctx.exit(SubmissionError.exit_code)


def _print(report: PolicyReport) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    table = Table(show_header=False, box=None, padding=(0, 1))
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for result in report.results:
        table.add_row(Text(result.status, style=_STYLES[result.status]), result.name, Text(result.found))
        if result.fix:
            table.add_row("", "", Text(f"to fix this: {result.fix}", style="dim"))
    seen = ", sees the ground truth" if report.privileged else ""
    console.print(Text(f"{report.policy} ({report.class_name} in {report.file}){seen}", style="bold"), soft_wrap=True)
    console.print(table)
    memory = report.peak_memory_bytes
    used = "" if memory is None else f"; at most {memory / (1 << 20):,.0f} MiB of memory"
    console.print(Text(f"{report.decisions:,} decisions in {', '.join(report.tasks)}{used}", style="dim"))
