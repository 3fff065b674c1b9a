"""``rema check``: what an evaluation would refuse, in seconds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from evaluator.cli.options import json_option, policy_options, tasks_option
from evaluator.cli.output import line, print_answer, print_table
from rema_data.errors import SubmissionError

if TYPE_CHECKING:
    from evaluator.policy.check_report import PolicyReport

__all__ = ["check"]

_STYLES = {"ok": "green", "warning": "yellow", "refused": "bold red"}


@click.command()
@click.argument("policy")
@tasks_option
@policy_options
@json_option
@click.pass_context
def check(ctx: click.Context, /, policy: str, tasks: tuple[str, ...] | None, as_json: bool, **options: Any) -> None:
    """Load POLICY in the sandbox and ask it some questions of every task: what would be refused, and how to fix it.

    POLICY is my_policy.py, my_policy.py:ClassName, or the name of an installed policy. The questions are validation
    scenarios at every step. They are asked again in another process, order and batch size, and timed.

    Exit code 3: `rema evaluate` or `rema submit` would refuse the policy.
    """
    # Imported here, so that a mistyped option is answered at once.
    from evaluator.cli.progress import StderrProgress
    from evaluator.policy.check import check_policy

    with StderrProgress() as progress:
        report = check_policy(policy, task=tasks, progress=progress, **options)
    print_answer(report, as_json, _print)
    if not report.ok:
        ctx.exit(SubmissionError.exit_code)


def _print(report: PolicyReport) -> None:
    from rich.text import Text

    seen = ", sees the ground truth" if report.privileged else ""
    line(f"{report.policy} ({report.class_name} in {report.file}){seen}", "bold")
    rows = [(Text(one.status, style=_STYLES[one.status]), one.name, one.found) for one in report.results]
    print_table(("state", "check", "found"), rows, header=False)
    for result in report.results:
        if result.fix:
            line(f"to fix {result.name}: {result.fix}", "yellow")
    memory = report.peak_memory_bytes
    used = "" if memory is None else f"; at most {memory / (1 << 20):,.0f} MiB of memory"
    line(f"{report.decisions:,} decisions in {', '.join(report.tasks)}{used}", "dim")
