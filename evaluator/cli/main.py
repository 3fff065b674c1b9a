"""The ``rema`` command: finds a verb, and turns errors into a sentence and an exit code.

Exit codes: 0 ok, 1 bug, 2 usage or bad input, 3 submission invalid, 4 policy failed on too many episodes,
5 infrastructure errors above the limit, 6 verification mismatch, 130 interrupted (resumable).
"""

from __future__ import annotations

import importlib
import importlib.metadata
from typing import Any

import click

from rema_data.errors import RemaError

__all__ = ["VERBS", "cli"]

VERBS: dict[str, str] = {
    "evaluate": "Score a policy on frozen scenarios.",
    "preview": "Show one step of a scenario as a picture.",
    "leaderboard": "Compare runs in one table, beside the paper's rates.",
    "scenarios": "Draw a new version of the frozen scenario lists.",
}
"""Verbs in the order of the help. Verb ``x`` is the click command ``x`` of the module ``evaluator.cli.x``."""

INTERRUPTED = 130


class _Verbs(click.Group):
    """A group that imports a verb only when it is called, so that ``rema --help`` is quick."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in VERBS:
            return None
        command: click.Command = getattr(importlib.import_module(f"{__package__}.{name}"), name)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Verbs"):
            formatter.write_dl(list(VERBS.items()))

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except RemaError as error:
            click.echo(f"rema: {error.message}", err=True)
            if error.hint:
                click.echo(error.hint, err=True)
            ctx.exit(error.exit_code)
        except KeyboardInterrupt:
            click.echo("\nrema: interrupted; run the same command again to resume", err=True)
            ctx.exit(INTERRUPTED)


def _print_version(ctx: click.Context, parameter: click.Parameter, wanted: bool) -> None:
    if wanted and not ctx.resilient_parsing:
        try:
            version = importlib.metadata.version("rema")
        except importlib.metadata.PackageNotFoundError:
            version = "(a checkout that is not installed)"
        click.echo(f"rema {version}")
        ctx.exit()


@click.group(cls=_Verbs, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120})
@click.option("--version", is_flag=True, is_eager=True, expose_value=False, callback=_print_version, help="Show it.")
def cli() -> None:
    """ReMa: manipulation with grippers and tools. Score policies on frozen scenarios and compare them."""
