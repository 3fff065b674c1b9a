"""``rema evaluate``: run a policy over frozen scenarios and print its rate."""

from __future__ import annotations

from pathlib import Path

import click

from evaluator.protocol import PROTOCOLS
from rema_data.errors import InputError
from rema_data.schema import TASKS

__all__ = ["evaluate"]


@click.command()
@click.argument("policy")
@click.option("--task", required=True, type=click.Choice(list(TASKS)), help="What has to be done.")
@click.option("--checkpoint", type=click.Path(path_type=Path), help="Weights, handed to the policy.")
@click.option("--episodes", type=click.IntRange(min=1), default=10_000, show_default=True, help="First N scenarios.")
@click.option("--workers", type=click.IntRange(min=1), help="Simulation processes.  [default: one a core]")
@click.option("--engine", type=click.Choice(["process", "inline", "ray"]), default="process", show_default=True)
@click.option("--address", help="Of a Ray cluster.  [default: the one that this machine belongs to]")
@click.option("--shard", metavar="I/N", help="Play this part of the scenarios; `rema merge` puts them together.")
@click.option("--protocol", type=click.Choice(list(PROTOCOLS)), default="conditional", show_default=True)
@click.option("--split", type=click.Choice(["test", "val"]), default="test", show_default=True)
@click.option("--output", type=click.Path(path_type=Path), help="Run folder.  [default: runs/POLICY-TASK-PROTOCOL]")
@click.option("--device", default="cpu", show_default=True, help="Handed to the policy, such as cuda:0.")
@click.option("--batch-size", type=click.IntRange(1, 4096), default=64, show_default=True, help="Observations a call.")
@click.option(
    "--quick",
    "against",
    metavar="RUN",
    type=click.Path(path_type=Path),
    help="Stop as soon as the policy is better or worse than that of RUN; unranked.",
)
@click.option("--sandbox", metavar="CMD", help="Wrapper of the policy's process (bwrap, ...): docs/threat_model.md.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary object alone.")
def evaluate(
    policy: str,
    task: str,
    checkpoint: Path | None,
    episodes: int,
    workers: int | None,
    engine: str,
    address: str | None,
    shard: str | None,
    protocol: str,
    split: str,
    output: Path | None,
    device: str,
    batch_size: int,
    against: Path | None,
    sandbox: str | None,
    as_json: bool,
) -> None:
    """Score POLICY on frozen scenarios and print its success rate with a 95 % interval.

    POLICY is my_policy.py, my_policy.py:ClassName, or a built-in name: random, scripted, reference, tae-joint,
    tae-separate, and tae, which needs a --checkpoint.

    A run that was stopped goes on where it stopped: run the same command again.
    """
    # Imported here, so that a mistyped option is answered at once.
    from evaluator.cli.progress import StderrProgress
    from evaluator.cli.result import print_result
    from evaluator.policy.loading import resolve, weights_of
    from evaluator.runner import EvaluationConfig, run_evaluation
    from evaluator.runner.shards import Part

    spec = resolve(policy)
    part = None if shard is None else Part.parse(shard)
    name = f"{spec.name}-{task}-{protocol}" + ("" if split == "test" else f"-{split}")
    if part is not None:
        name += f"-shard-{part.number}-of-{part.count}"
    config = EvaluationConfig(
        policy=spec,
        task=task,
        output=output or Path("runs") / name,
        checkpoint=weights_of(spec, checkpoint),
        device=device,
        protocol=protocol,
        split=split,
        episodes=episodes,
        engine=engine,
        workers=workers,
        batch_size=batch_size,
        sandbox=sandbox,
        address=address,
        shard=part,
    )
    if against is not None and part is not None:
        raise InputError("--quick plays the list in its order", hint="drop --quick or --shard")
    with StderrProgress() as progress:
        if against is None:
            result = run_evaluation(config, progress)
        else:
            from evaluator.runner.quick import quick_evaluation

            result = quick_evaluation(config, against, progress)
    print_result(result.summary, result.folder, as_json)
