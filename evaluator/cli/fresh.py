"""``rema fresh``: a secret seed for an evaluation, committed to before and published after."""

from __future__ import annotations

import secrets

import click

from evaluator.cli.output import line

__all__ = ["fresh"]


@click.group()
def fresh() -> None:
    """Evaluate on scenarios that no policy can have seen: commit to a secret seed, and publish it afterwards.

    An organiser publishes the sha256 of `rema fresh commit`, collects policies, scores them with `rema evaluate
    --fresh SEED`, and publishes the seed. Everybody can check it with `rema fresh reveal`, and score again.
    """


@fresh.command()
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), help="[default: a random one]")
def commit(seed: int | None) -> None:
    """Print a seed, to be kept secret, and the sha256 to publish."""
    from evaluator.scenarios.seeds import commitment

    chosen = secrets.randbelow(2**63) if seed is None else seed
    line(f"seed (keep it secret): {chosen}")
    line(f"sha256 (publish it):   {commitment(chosen)}")


@fresh.command()
@click.argument("seed", type=click.IntRange(0, 2**63 - 1))
@click.argument("sha256")
def reveal(seed: int, sha256: str) -> None:
    """Check that SEED is the one that was committed to with SHA256."""
    from evaluator.scenarios.seeds import commitment
    from rema_data.errors import IntegrityError

    if commitment(seed) != sha256.strip().lower():
        raise IntegrityError(
            f"the seed {seed} is not the one of {sha256}: its sha256 is {commitment(seed)}",
            hint="ask for the seed that was committed to",
        )
    line(f"{seed} is the seed that was committed to: rema evaluate POLICY --task TASK --fresh {seed}")
