"""``rema preview``: one step of a frozen scenario as a picture."""

from __future__ import annotations

import json
from pathlib import Path

import click

from evaluator.protocol import PROTOCOLS
from rema_data.errors import InputError
from rema_data.schema import TASKS

__all__ = ["preview"]


@click.command()
@click.option("--task", required=True, type=click.Choice(list(TASKS)), help="What has to be done.")
@click.option("--scenario", "index", required=True, type=click.IntRange(min=0), help="Position in the frozen list.")
@click.option("--split", type=click.Choice(["test", "val"]), default="test", show_default=True)
@click.option("--policy", metavar="POLICY", help="Who acts: as for `rema evaluate`.  [default: scripted]")
@click.option("--checkpoint", type=click.Path(path_type=Path), help="Weights, handed to the policy.")
@click.option("--action", metavar="I,J,K", help="Row, column and angle, instead of a policy.")
@click.option("--protocol", type=click.Choice(list(PROTOCOLS)), default="conditional", show_default=True)
@click.option("--output", type=click.Path(path_type=Path), help="PNG file.  [default: preview-TASK-N.png]")
@click.option("--json", "as_json", is_flag=True, help="Print the outcome as an object.")
def preview(
    task: str,
    index: int,
    split: str,
    policy: str | None,
    checkpoint: Path | None,
    action: str | None,
    protocol: str,
    output: Path | None,
    as_json: bool,
) -> None:
    """Draw the maps, the action, and the world before and after it, into a PNG file.

    With --protocol end-to-end the policy does every step, and the picture shows the step at which the episode ended.
    """
    # Imported here, so that a mistyped option is answered at once.
    from evaluator.policy.loading import resolve
    from evaluator.preview import asked, check_action, find_scenario, find_step, play, write_preview
    from rema_data.schema import to_dict

    if action is not None and (policy is not None or protocol != "conditional"):
        raise InputError(
            "--action takes the place of a policy, at the last step", hint="drop --policy and --protocol, or --action"
        )
    wanted = None if action is None else _parse(action)
    scenario = find_scenario(task, index, split, protocol)
    if wanted is not None:
        situation = scenario.last_situation()
        chosen, who = check_action(situation, *wanted), "a given action"
    else:
        spec = resolve(policy or "scripted")
        who = spec.name
        with asked(spec, checkpoint) as answer:
            situation, chosen = find_step(scenario, protocol, answer)
    played = play(situation, chosen)
    path = output or Path(f"preview-{task}-{index}.png")
    write_preview(played, path, f"{task}, scenario {index} ({split}, {protocol}), {who}")
    outcome = played.outcome
    if as_json:
        row = {"file": str(path), "step": situation.step, "action": chosen, "outcome": to_dict(outcome)}
        click.echo(json.dumps(row))
    else:
        click.echo(f"{path}: {'success' if outcome.success else outcome.failure}")


def _parse(action: str) -> tuple[int, int, int]:
    try:
        i, j, k = (int(part) for part in action.split(","))
    except ValueError:
        raise InputError(
            f"{action!r} is not an action", hint="write three whole numbers: --action 32,32,0", action=action
        ) from None
    return i, j, k
