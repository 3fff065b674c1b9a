"""The ``rema`` command: finds a verb, and turns errors into a sentence and an exit code.

Exit codes: 0 ok, 1 bug, 2 usage or bad input, 3 submission invalid, 4 policy failed on too many episodes, 5
infrastructure errors above the limit, 6 verification mismatch, 130, 143 or 129 interrupted by SIGINT, SIGTERM or SIGHUP
(run the same command again).
"""

from __future__ import annotations

import atexit
import errno
import importlib
import io
import logging
import sys
import warnings
from typing import Any, NamedTuple

import click

from evaluator.cli.output import note
from rema_data import interrupts
from rema_data.errors import InputError, RemaError

__all__ = ["VERBS", "Verb", "cli"]


class Verb(NamedTuple):
    """Where the click command of a verb is (``module:attribute``), and its line in the help."""

    target: str
    help: str


VERBS: dict[str, Verb] = {
    "download": Verb("evaluator.cli.download:download", "Fetch a release of the dataset, or a part of it."),
    "stats": Verb("evaluator.cli.stats:stats", "Count positives and negatives of a release."),
    "verify": Verb("evaluator.cli.verify:verify", "Check every byte and every invariant of a release."),
    "diff": Verb("evaluator.cli.diff:diff", "Compare two releases: blocks, rows and columns."),
    "doctor": Verb("evaluator.cli.doctor:doctor", "Check this machine: versions, cache, reading speed."),
    "preview": Verb("evaluator.cli.preview:preview", "Show a step of a scenario or of a release as a picture."),
    "view": Verb("evaluator.cli.view:view", "Browse every episode of a release or of a run in a page."),
    "export": Verb("evaluator.cli.export:export", "Write a release in another format."),
    "publish": Verb("baselines.publish.command:publish", "Write a release or networks ready for the Hugging Face Hub."),
    "import": Verb("evaluator.cli.import_:import_", "Bring an exported release back."),
    "collect": Verb("baselines.rounds.command:collect", "Run a collection plan and seal a release."),
    "train": Verb("baselines.train.command:train", "Train a network on a release."),
    "rounds": Verb("baselines.rounds.command:rounds", "Collect and train in rounds, as a plan says."),
    "check": Verb("evaluator.cli.check:check", "Check a policy in seconds: what would be refused, and why."),
    "evaluate": Verb("evaluator.cli.evaluate:evaluate", "Score a policy on frozen scenarios."),
    "fresh": Verb("evaluator.cli.fresh:fresh", "Commit to a secret seed of scenarios, and reveal it."),
    "merge": Verb("evaluator.cli.merge:merge", "Merge the shards of an evaluation."),
    "replay": Verb("evaluator.cli.replay:replay", "Check a finished run by simulating its actions again."),
    "leaderboard": Verb(
        "evaluator.cli.leaderboard:leaderboard", "Compare runs in one table, beside the paper's rates."
    ),
    "report": Verb("evaluator.cli.report:report", "Write one page about a run, with pictures of its episodes."),
    "compare": Verb("evaluator.cli.compare:compare", "Compare two policies scenario by scenario."),
    "submit": Verb("evaluator.cli.submit:submit", "Check a run and pack it into a leaderboard entry."),
    "scenarios": Verb("evaluator.cli.scenarios:scenarios", "Draw a new version of the frozen scenario lists."),
}
"""Verbs in the order of the help. A target is a name and not an import: it may lie in a package above this one."""

INTERRUPTED = 130
RESUMED = frozenset({"download", "collect", "train", "rounds", "evaluate", "scenarios"})
"""Verbs that resume where they were interrupted. The others start again, and leave nothing half-written."""


class _Verbs(click.Group):
    """A group that imports a verb only when it is called, so that ``rema --help`` is quick."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in VERBS:
            return None
        module, _, attribute = VERBS[name].target.partition(":")
        command: click.Command = getattr(importlib.import_module(module), attribute)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Verbs"):
            formatter.write_dl([(name, verb.help) for name, verb in VERBS.items()])

    def invoke(self, ctx: click.Context) -> Any:
        _prepare_streams()
        try:
            with interrupts.listening():
                interrupts.check()
                return super().invoke(ctx)
        except RemaError as error:
            note(f"rema: {error}")
            ctx.exit(error.exit_code)
        except OSError as error:
            if error.errno == errno.EPIPE:
                raise  # the reader of our output has closed it: click ends silently
            place = "" if error.filename is None else f": {error.filename}"
            note(f"rema: the system refused: {error.strerror or error}{place}")
            ctx.exit(InputError.exit_code)
        except KeyboardInterrupt as error:
            atexit.register(_say_no_more)
            end = " to resume" if ctx.invoked_subcommand in RESUMED else ""
            note(f"\nrema: interrupted; run the same command again{end}")
            ctx.exit(error.exit_code if isinstance(error, interrupts.Interrupted) else INTERRUPTED)


def _say_no_more() -> None:
    """Silence threads of libraries that report what they were doing when they were interrupted (Zarr's tasks)."""
    logging.disable()
    warnings.simplefilter("ignore")
    sys.unraisablehook = lambda _: None


def _prepare_streams() -> None:
    """Show a character that the terminal lacks as an escape, instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _print_version(ctx: click.Context, parameter: click.Parameter, asked: bool) -> None:
    if asked and not ctx.resilient_parsing:
        import importlib.metadata  # a fifth of the time of `rema --help`

        try:
            version = importlib.metadata.version("rema")
        except importlib.metadata.PackageNotFoundError:
            version = "(a checkout that is not installed)"
        click.echo(f"rema {version}")
        ctx.exit()


@click.group(cls=_Verbs, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120})
@click.option("--version", is_flag=True, is_eager=True, expose_value=False, callback=_print_version, help="Show it.")
def cli() -> None:
    """ReMa: manipulation with grippers and tools. The dataset, the simulated world, and the evaluator of policies."""
