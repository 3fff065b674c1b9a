"""``rema train``: train a network on a release."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evaluator.cli.options import device_option, json_option, where_option
from evaluator.cli.output import print_json
from rema_data.schema import Primitive

if TYPE_CHECKING:
    from baselines.train.result import Trained

__all__ = ["train"]

_SHAPE = ("width", "scene_stride", "ee_stride", "up_align_corners", "correlation_scale")
"""Options that are fields of the architecture."""
_MOST_SEEDS = 1000


def _names(context: click.Context, parameter: click.Parameter, value: str | None) -> tuple[str, ...]:
    """Names separated by commas."""
    return tuple(name.strip() for name in (value or "").split(",") if name.strip())


def _seeds(context: click.Context, parameter: click.Parameter, value: str | None) -> tuple[int, ...]:
    """Numbers and ranges separated by commas."""
    found: list[int] = []
    for part in _names(context, parameter, value):
        match = re.fullmatch(r"(\d{1,9})(?:-(\d{1,9}))?", part)
        numbers = range(int(match[1]), int(match[2] or match[1]) + 1) if match else range(0)
        if not 0 < len(numbers) <= _MOST_SEEDS:
            raise click.BadParameter(f"{part!r} is not a number or a short range, such as 0-2 or 0,3")
        found.extend(numbers)
    if len(set(found)) != len(found):
        raise click.BadParameter("a seed is named twice")
    return tuple(found)


def _shares(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, float]:
    """SKILL=NUMBER, some times."""
    found: dict[str, float] = {}
    for text in values:
        name, _, number = text.partition("=")
        try:
            found[name.strip()] = float(number)
        except ValueError:
            raise click.BadParameter(f"{text!r} is not a share, such as grasp_push=3") from None
    return found


@click.command()
@click.option("--release", required=True, help="Name of a release, or its folder.")
@click.option("--tasks", required=True, callback=_names, help="Whose steps are used, separated by commas.")
@click.option(
    "--primitive",
    required=True,
    type=click.Choice([item.value for item in Primitive]),
    help="Which network: grasp or push.",
)
@click.option("--skills", callback=_names, help="Steps of some skills only, separated by commas.  [default: all]")
@click.option("--subset", metavar="10pct-r1", help="A fixed 1 or 10 % of the training episodes, replicate 1 to 10.")
@where_option
@click.option("--output", required=True, type=click.Path(path_type=Path), help="Folder of the networks of a policy.")
@click.option("--name", help="Of the network in it.  [default: the primitive]")
@click.option("--updates", type=int, default=160_000, show_default=True, help="Steps of the optimiser.")
@click.option("--batch-size", type=int, default=8, show_default=True, help="Samples an update.")
@click.option("--learning-rate", type=float, default=1e-4, show_default=True, help="Of Adam.")
@click.option(
    "--schedule",
    type=click.Choice(["constant", "cosine"]),
    default="constant",
    show_default=True,
    help="cosine: the rate falls to zero over the updates.",
)
@click.option(
    "--balance",
    type=click.Choice(["exact", "average"]),
    default="exact",
    show_default=True,
    help="Of skill and success: in every minibatch, or on average.",
)
@click.option(
    "--share",
    "shares",
    multiple=True,
    callback=_shares,
    metavar="SKILL=NUMBER",
    help="Draws of a skill for one of each other.",
)
@click.option(
    "--hard-share",
    type=float,
    default=0.0,
    show_default=True,
    help="Share of the failures of a minibatch that are the hardest ones found.",
)
@click.option("--hard-every", type=int, default=500, show_default=True, help="Updates between two searches for them.")
@click.option(
    "--on-empty",
    type=click.Choice(["raise", "renormalise"]),
    default="raise",
    show_default=True,
    help="A skill without successes or failures: refuse, or use the rest.",
)
@click.option("--rotate/--no-rotate", default=True, show_default=True, help="Turn grasps.")
@click.option("--mirror/--no-mirror", default=True, show_default=True, help="Mirror pushes.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of weights, draws and augmentations.")
@click.option("--seeds", callback=_seeds, metavar="0-2", help="One training a seed, each in OUTPUT/seed-N.")
@click.option(
    "--precision",
    type=click.Choice(["float32", "bfloat16"]),
    default="float32",
    show_default=True,
    help="Of the layers while they learn; weights are float32.",
)
@click.option("--validate-every", type=int, default=2_000, show_default=True, help="Updates between two validations.")
@click.option("--validation-steps", type=int, default=1_000, show_default=True, help="Steps scored in a validation.")
@click.option("--width", type=int, default=64, show_default=True, help="Channels of the widest layers.")
@click.option("--scene-stride", type=int, default=4, show_default=True, help="4 or 2: pixels in a cell of the scene.")
@click.option("--ee-stride", type=int, default=4, show_default=True, help="4 or 2: pixels in a cell of the kernel.")
@click.option("--up-align-corners/--no-up-align-corners", default=True, show_default=True, help="Of the upsampling.")
@click.option(
    "--correlation-scale",
    type=click.Choice(["none", "cells"]),
    default="none",
    show_default=True,
    help="Divide the cross-convolution by the cells of its kernel.",
)
@click.option("--pictures", type=click.Path(path_type=Path), metavar="FILE.png", help="Draw maps of validation steps.")
@device_option
@click.option("--deterministic", is_flag=True, help="Refuse operations that may differ between two runs.")
@json_option
def train(
    release: str,
    output: Path,
    name: str | None,
    device: str,
    deterministic: bool,
    seeds: tuple[int, ...],
    pictures: Path | None,
    as_json: bool,
    **values: Any,
) -> None:
    """Train a TAE network: one labelled place and angle a sample, balanced over skill and success.

    To resume a training that was stopped or killed, from its last saved state, run the same command again. The
    weights with the best validation AUC become OUTPUT/NAME.safetensors, with a JSON file that says what they are.
    With --seeds, --json prints a list.
    """
    from baselines.devices import training_device
    from baselines.train.config import TrainingConfig
    from baselines.train.loop import train as run
    from baselines.train.result import check_network_name
    from evaluator.cli.progress import StderrProgress
    from rema_data.loader.release import load
    from rema_data.validation import validated

    if seeds and pictures is not None:
        raise click.UsageError("--pictures draws the maps of one network: give --seed in place of --seeds")
    values["architecture"] = {field: values.pop(field) for field in _SHAPE}
    first = validated(TrainingConfig, values, "rema train", hint="see rema train --help")
    chosen = name or first.primitive
    check_network_name(chosen)
    training_device(device)  # before a release is fetched from its files
    if pictures is not None:
        from baselines.train.pictures import require_matplotlib

        require_matplotlib()
    trainings = {output / f"seed-{seed}": replace(first, seed=seed) for seed in seeds} or {output: first}
    results = []
    with StderrProgress(in_bytes=True) as decoding:
        opened = load(release, progress=decoding)
        _ = opened.cache  # decoded here, where this takes time
    with StderrProgress() as progress:
        for folder, config in trainings.items():
            done = run(opened, config, folder, chosen, device=device, deterministic=deterministic, progress=progress)
            results.append(done)
            if not as_json:
                progress.result(_sentence(done))
    if pictures is not None:
        from baselines.tae.checkpoint import load_checkpoint
        from baselines.train.data import open_data
        from baselines.train.pictures import draw_maps

        draw_maps(load_checkpoint(output / chosen)[0], open_data(opened, first).validation, pictures)
    if as_json:
        cards = [done.checkpoint.to_dict() for done in results]
        print_json(cards if seeds else cards[0])


def _sentence(done: Trained) -> str:
    measures = done.checkpoint.metrics
    how = "was there" if done.already else "is trained"
    return (
        f"{done.folder / done.name}.safetensors {how}: validation AUC {measures['auc']:.3f}, balanced accuracy "
        f"{measures['balanced_accuracy']:.1%} after {done.checkpoint.updates:,} updates"
    )
