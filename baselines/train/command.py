"""``rema train``: train a network on a release."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rema_data.schema import Primitive

if TYPE_CHECKING:
    from torch import Tensor

    from baselines.train.loop import Report
    from evaluator.cli.progress import StderrProgress

__all__ = ["reporter", "train"]

_READ_EVERY = 20
"""Updates between two looks at the loss: each waits until the device has done all that it was told."""


def _names(context: click.Context, parameter: click.Parameter, value: str | None) -> tuple[str, ...]:
    """Names separated by commas."""
    return tuple(name.strip() for name in (value or "").split(",") if name.strip())


@click.command()
@click.option("--release", required=True, help="Name of a release, or its folder.")
@click.option("--tasks", required=True, callback=_names, help="Whose steps are used, separated by commas.")
@click.option("--primitive", required=True, type=click.Choice([item.value for item in Primitive]))
@click.option("--skills", callback=_names, help="Steps of some skills only, separated by commas.  [default: all]")
@click.option("--output", required=True, type=click.Path(path_type=Path), help="Folder of the networks of a policy.")
@click.option("--name", help="Of the network in it.  [default: the primitive]")
@click.option("--updates", type=int, default=160_000, show_default=True, help="Steps of the optimiser.")
@click.option("--batch-size", type=int, default=8, show_default=True)
@click.option("--learning-rate", type=float, default=1e-4, show_default=True)
@click.option("--schedule", type=click.Choice(["constant", "cosine"]), default="constant", show_default=True)
@click.option("--balance", type=click.Choice(["exact", "average"]), default="exact", show_default=True)
@click.option("--on-empty", type=click.Choice(["raise", "renormalise"]), default="raise", show_default=True)
@click.option("--rotate/--no-rotate", default=True, show_default=True, help="Turn grasps.")
@click.option("--mirror/--no-mirror", default=True, show_default=True, help="Mirror pushes.")
@click.option("--seed", type=int, default=0, show_default=True)
@click.option("--validate-every", type=int, default=2_000, show_default=True, help="Updates between two validations.")
@click.option("--validation-steps", type=int, default=1_000, show_default=True)
@click.option("--width", type=int, default=64, show_default=True, help="Channels of the widest layers.")
@click.option("--scene-stride", type=int, default=4, show_default=True, help="4 or 2: pixels in a cell of the scene.")
@click.option("--ee-stride", type=int, default=4, show_default=True, help="4 or 2: pixels in a cell of the kernel.")
@click.option("--up-align-corners/--no-up-align-corners", default=True, show_default=True)
@click.option("--correlation-scale", type=click.Choice(["none", "cells"]), default="none", show_default=True)
@click.option("--pictures", type=click.Path(path_type=Path), metavar="FILE.png", help="Draw maps of validation steps.")
@click.option("--device", default="cpu", show_default=True)
@click.option("--deterministic", is_flag=True, help="Refuse operations that may differ between two runs.")
@click.option("--json", "as_json", is_flag=True, help="Print the card of the network alone.")
def train(
    release: str,
    output: Path,
    name: str | None,
    device: str,
    deterministic: bool,
    pictures: Path | None,
    as_json: bool,
    width: int,
    scene_stride: int,
    ee_stride: int,
    up_align_corners: bool,
    correlation_scale: str,
    **values: Any,
) -> None:
    """Train a TAE network: one labelled place and angle a sample, balanced over skill and success.

    A training that was stopped, or killed, goes on where its last state was saved: run the same command again. The
    weights with the best validation AUC become OUTPUT/NAME.safetensors, with a JSON file that says what they are.
    """
    from baselines.devices import training_device
    from baselines.tae.network import Architecture
    from baselines.train.config import TrainingConfig
    from baselines.train.loop import train as run
    from baselines.train.result import check_network_name
    from evaluator.cli.progress import StderrProgress
    from rema_data.loader.release import load

    shape = Architecture(width, scene_stride, ee_stride, up_align_corners, correlation_scale)
    config = TrainingConfig(**values, architecture=shape)
    chosen = name or config.primitive
    check_network_name(chosen)
    training_device(device)  # before a release is fetched from its files
    if pictures is not None:
        from baselines.train.pictures import require_matplotlib

        require_matplotlib()
    with StderrProgress() as progress:
        report = reporter(progress, f"train {chosen}", config.updates)
        opened = load(release)
        done = run(opened, config, output, chosen, device=device, deterministic=deterministic, report=report)
    if pictures is not None:
        from baselines.tae.checkpoint import load_checkpoint
        from baselines.train.data import open_data
        from baselines.train.pictures import draw_maps

        draw_maps(load_checkpoint(output / chosen)[0], open_data(opened, config).validation, pictures)
    if as_json:
        click.echo(json.dumps(done.checkpoint.to_dict(), indent=2))
        return
    measures = done.checkpoint.metrics
    how = "was there" if done.already else "is trained"
    click.echo(
        f"{done.folder / done.name}.safetensors {how}: validation AUC {measures['auc']:.3f}, balanced accuracy "
        f"{measures['balanced_accuracy']:.1%} after {done.checkpoint.updates:,} updates"
    )


def reporter(progress: StderrProgress, what: str, updates: int) -> Report:
    """What shows a training on stderr: a bar with the running loss, and a line for every validation."""
    progress.phase(what, updates)
    pace = _Pace()

    def report(update: int, facts: dict[str, Any]) -> None:
        if "resumed" in facts:
            counts = [str(count) for count in facts["threads"]]
            mixed = f"; with {' and '.join(counts)} threads, so not to the weights that one number of them gives"
            progress.note(f"{what}: goes on after update {update:,} of {updates:,}{mixed if len(counts) > 1 else ''}")
            progress.resume(update)
            pace.begin()
        elif "auc" in facts:
            skills = ", ".join(f"{name} {entry['auc']:.3f}" for name, entry in facts["skills"].items())
            progress.note(
                f"{what}: update {update:,}, loss {facts['training_loss']:.3f}, validation AUC {skills}, balanced "
                f"accuracy {facts['balanced_accuracy']:.1%}, calibration error {facts['calibration_error']:.3f}; "
                f"{facts['samples_per_second']:.0f} samples/s, {facts['waiting_share']:.1%} of the time for data"
            )
            pace.begin()  # what the validation took is no time of the updates
        else:
            progress.advance(1)
            if words := pace.after(facts["loss"], facts["samples"]):
                progress.tell(words)

    return report


class _Pace:
    """Loss and samples a second over the last so many updates."""

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        self._losses: list[Tensor] = []
        self._samples, self._since = 0, time.perf_counter()

    def after(self, loss: Tensor, samples: int) -> str:
        """What to say after an update; mostly nothing."""
        self._losses.append(loss)
        self._samples += samples
        if len(self._losses) < _READ_EVERY:
            return ""
        mean = float(sum(self._losses[1:], self._losses[0])) / len(self._losses)
        words = f"loss {mean:.3f}, {self._samples / (time.perf_counter() - self._since):,.0f} samples/s"
        self.begin()
        return words
