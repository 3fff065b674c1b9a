"""``rema evaluate``: run a policy over frozen scenarios and print its rate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from evaluator.cli.options import engine_options, json_option, policy_options
from evaluator.protocol import BLANKED, FRESH_SCENARIOS, MAX_BATCH, PROTOCOLS
from rema_data.schema import TASKS

__all__ = ["evaluate"]

_EPISODES = f"First N scenarios.  [default: all; of a fresh list {FRESH_SCENARIOS}]"


@click.command()
@click.argument("policy")
@click.option("--task", required=True, type=click.Choice(list(TASKS)), help="What has to be done.")
@click.option("--episodes", type=click.IntRange(min=1), help=_EPISODES)
@click.option("--suite", metavar="hard-v1", help="Play a generalisation suite in place of the clean scenarios.")
@click.option("--fresh", type=int, metavar="SEED", help="Draw a list from a seed, and play it: see docs/evaluate.md.")
@policy_options
@engine_options
@click.option("--shard", metavar="I/N", help="Play this shard of the scenarios; `rema merge` merges them.")
@click.option(
    "--protocol",
    type=click.Choice([*PROTOCOLS, *BLANKED]),
    default="conditional",
    show_default=True,
    help="Steps that are played, and what is shown.",
)
@click.option("--split", type=click.Choice(["test", "val"]), default="test", show_default=True, help="Scenario list.")
@click.option("--output", type=click.Path(path_type=Path), help="Run folder.  [default: runs/POLICY-TASK-PROTOCOL]")
@click.option(
    "--batch-size", type=click.IntRange(1, MAX_BATCH), default=64, show_default=True, help="Observations a call."
)
@click.option(
    "--quick",
    metavar="RUN",
    type=click.Path(path_type=Path),
    help="Stop as soon as the policy is better or worse than that of RUN; unranked.",
)
@json_option
def evaluate(policy: str, as_json: bool, **options: Any) -> None:
    """Score POLICY on frozen scenarios and print its success rate with a 95 % interval.

    POLICY is my_policy.py, my_policy.py:ClassName, or the name of an installed policy, such as random or tae-joint; an
    unknown name lists them. `rema check POLICY` says in seconds what would be refused.

    A run that was stopped is resumed: run the same command again.
    """
    # Imported here, so that a mistyped option is answered at once.
    from evaluator import evaluate as run
    from evaluator.cli.progress import StderrProgress
    from evaluator.cli.result import print_result

    with StderrProgress() as progress:
        result = run(policy, progress=progress, **options)
    print_result(result.summary, result.folder, as_json, over_suite=options["suite"] is not None)
