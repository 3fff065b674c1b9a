"""``rema preview``: one step of a frozen scenario, or steps of a release, as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from evaluator.cli.options import checkpoint_option, json_option, rounds_option, tasks_option
from evaluator.cli.output import line, plain, print_json, print_table
from evaluator.protocol import PROTOCOLS
from rema_data.errors import InputError
from rema_data.schema import TASKS, Failure

if TYPE_CHECKING:
    from rema_data.gallery import GalleryStep

__all__ = ["preview"]

_OF_SCENARIOS = ("policy", "checkpoint", "action", "protocol")
_OF_RELEASES = ("release", "rounds", "episodes", "count", "which", "success", "failure", "as_table")


@click.command()
@tasks_option
@click.option("--split", type=click.Choice(["test", "val", "train"]), help="Of scenarios: test or val.")
@click.option("--output", type=click.Path(path_type=Path), help="PNG file, or HTML for a release.")
@json_option
@click.option("--release", metavar="RELEASE", help="Name or folder.  [default: the newest one on this machine]")
@rounds_option
@click.option("--episode", "episodes", multiple=True, type=click.IntRange(min=0), help="All its steps (repeatable).")
@click.option("--count", type=click.IntRange(1, 1000), help="Draw so many steps.  [default: 12]")
@click.option("--which", type=click.Choice(["last", "picks", "all"]), help="Steps to draw from.  [default: last]")
@click.option("--success", is_flag=True, default=None, help="Only steps that succeeded.")
@click.option("--failure", type=click.Choice([str(label) for label in Failure]), help="Only steps that failed so.")
@click.option("--table", "as_table", is_flag=True, default=None, help="Print a table; draw only with --output.")
@click.option("--scenario", "index", type=click.IntRange(min=0), help="Position in the frozen list of the task.")
@click.option("--policy", metavar="POLICY", help="Who acts: as for `rema evaluate`.  [default: scripted]")
@checkpoint_option
@click.option("--action", metavar="I,J,K", help="Row, column and angle, instead of a policy.")
@click.option("--protocol", type=click.Choice(list(PROTOCOLS)), help="[default: conditional]")
@click.pass_context
def preview(ctx: click.Context, /, index: int | None, **options: Any) -> None:
    """Draw steps of a release, or with --scenario play a step of a frozen scenario and draw it.

    Of a release: a sheet of steps with their maps, actions and outcomes. The steps look drawn at random; they are
    always the same ones.

    Of a scenario: the maps, the action, and the world before and after it. With --protocol end-to-end the policy does
    every step, and the picture shows the step at which the episode ended.
    """
    foreign = _OF_SCENARIOS if index is None else _OF_RELEASES
    for name in foreign:
        if options[name] not in (None, ()):
            flag = next(parameter.opts[0] for parameter in ctx.command.params if parameter.name == name)
            if index is None:
                raise InputError(f"{flag} is for scenarios", hint="add --scenario N")
            raise InputError(f"{flag} is for releases", hint=f"drop --scenario or {flag}")
    mine = {name: value for name, value in options.items() if name not in foreign}
    if index is None:
        _preview_release(**mine)
    else:
        _preview_scenario(index, **mine)


def _preview_release(
    *,
    output: Path | None,
    as_json: bool,
    release: str | None,
    count: int | None,
    which: Literal["last", "picks", "all"] | None,
    as_table: bool | None,
    **chosen: Any,
) -> None:
    from rema_data.gallery import find_steps
    from rema_data.release.folder import find_release
    from rema_data.sheets import write_pictures

    if chosen["success"] and chosen["failure"]:
        raise InputError("a step that succeeded has no failure", hint="drop --success or --failure")
    if chosen["episodes"] and (count or which):
        raise InputError("--episode shows all steps of an episode", hint="drop --count and --which, or --episode")
    found = find_release(release)
    name = found.manifest.name
    steps = find_steps(found, which=which or "last", count=count or 12, **chosen)
    path = output if output or as_table else Path(f"preview-{name}.png")
    if path is not None:
        write_pictures(steps, path, f"{name} ({found.manifest.sha256[:12]})")
    if as_json:
        file = {} if path is None else {"file": str(path)}
        print_json({"release": name, **file, "steps": [dict(step.row) for step in steps]})
        return
    if as_table:
        _print_table(steps, name)
    if path is not None:
        line(f"{path}: {len(steps)} steps")


def _print_table(steps: Sequence[GalleryStep], title: str) -> None:
    from rema_data.pictures import outcome_text

    rows = []
    for row in (step.row for step in steps):
        push = row["primitive"] == "push"
        rows.append(
            (
                f"{row['task']} {row['step'] + 1}/{len(TASKS[row['task']])}",
                f"{row['round']} {row['split']} {row['episode']}",
                row["policy"],
                f"{row['i']},{row['j']},{row['k']}",
                f"{(row['displacement_m'] if push else row['lift_m']) * 100:+.1f} {'x' if push else 'z'}",
                plain(outcome_text(row), "green" if row["success"] else "red"),
            )
        )
    print_table(("step", "episode", "policy", "i,j,k", "cm", "outcome"), rows, title=title, right=("cm",))


def _preview_scenario(
    index: int,
    tasks: tuple[str, ...] | None,
    split: str | None,
    output: Path | None,
    as_json: bool,
    policy: str | None,
    checkpoint: Path | None,
    action: str | None,
    protocol: str | None,
) -> None:
    if tasks is None or len(tasks) != 1:
        raise InputError("a scenario belongs to one task", hint=f"name it: --task {next(iter(TASKS))}")
    if split == "train":
        raise InputError("there are no training scenarios", hint="use --split test or val, or --release")
    (task,), split, protocol = tasks, split or "test", protocol or "conditional"
    if action is not None and (policy is not None or protocol != "conditional"):
        raise InputError(
            "--action takes the place of a policy, at the last step", hint="drop --policy and --protocol, or --action"
        )
    given = None if action is None else _parse(action)
    # Imported here, so that a mistyped option is answered at once.
    from evaluator.cli.quiet import import_pybullet
    from evaluator.policy.loading import resolve, weights_of

    import_pybullet()
    from evaluator.render.film import FilmMaker
    from evaluator.render.preview import check_action, chosen_by, write_preview
    from evaluator.rollout.episode import frozen_scenario
    from evaluator.scenarios import load_list
    from rema_data.schema import to_dict

    scenario = frozen_scenario(load_list(task, split), index, protocol)
    with FilmMaker() as films:
        if given is not None:
            situation = scenario.last_situation()
            take, who = films.take(situation, check_action(situation, *given)), "a given action"
        else:
            spec = resolve(policy or "scripted")
            who = spec.name
            with chosen_by(spec, weights_of(spec, checkpoint, task)) as choose:
                take = films.play(scenario, protocol, choose)
    path = output or Path(f"preview-{task}-{index}.png")
    write_preview(take, path, f"{task}, scenario {index} ({split}, {protocol}), {who}")
    outcome = take.outcome
    if as_json:
        facts = {"step": take.situation.step, "action": take.action, "outcome": to_dict(outcome)}
        print_json({"file": str(path), **facts})
    else:
        line(f"{path}: {'success' if outcome.success else outcome.failure}")


def _parse(action: str) -> tuple[int, int, int]:
    try:
        i, j, k = (int(part) for part in action.split(","))
    except ValueError:
        raise InputError(
            f"{action!r} is not an action", hint="write three whole numbers: --action 32,32,0", action=action
        ) from None
    return i, j, k
