"""Options and arguments that several verbs have, declared once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from rema_data.schema import TASKS
from rema_data.store.keys import SPLITS

__all__ = [
    "block_options",
    "checkpoint_option",
    "device_option",
    "engine_options",
    "json_option",
    "policy_options",
    "release_argument",
    "rounds_option",
    "sources_option",
    "tasks_option",
    "where_option",
    "workers_option",
]

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def _all_of(*options: Decorator) -> Decorator:
    """One decorator for several options, which the help shows in this order."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


def _or_none(context: click.Context, parameter: click.Parameter, value: tuple[Any, ...]) -> tuple[Any, ...] | None:
    return value or None


release_argument = click.argument("release", required=False)
_TASK, _ROUND = click.Choice(list(TASKS)), click.IntRange(min=1)
tasks_option = click.option(
    "--task", "tasks", multiple=True, type=_TASK, callback=_or_none, help="Only this task (repeatable)."
)
rounds_option = click.option(
    "--round", "rounds", multiple=True, type=_ROUND, callback=_or_none, help="Only this round (repeatable)."
)
block_options = _all_of(
    tasks_option, rounds_option, click.option("--split", type=click.Choice(list(SPLITS)), help="Only this split.")
)
"""Blocks of a release: ``tasks``, ``rounds`` and ``split``, each None where all are meant."""
where_option = click.option(
    "--where",
    metavar="SQL",
    help="Only steps that meet a condition: \"lift_m < 0.1 and target_shape = 'T'\" (needs rema[query]).",
)
sources_option = click.option(
    "--source",
    "sources",
    multiple=True,
    metavar="URL",
    help="Folder of releases to ask first: a path, https://, hf://datasets/ORG/NAME, s3://, ... (repeatable; in order)",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print one object.")
checkpoint_option = click.option("--checkpoint", type=click.Path(path_type=Path), help="Weights, handed to the policy.")
device_option = click.option("--device", default="cpu", show_default=True, help="Of the networks, such as cuda:0.")
policy_options = _all_of(
    checkpoint_option,
    device_option,
    click.option(
        "--sandbox", metavar="CMD", help="Wrapper of the policy's process (bwrap, ...): docs/threat_model.md."
    ),
)
workers_option = click.option(
    "--workers", type=click.IntRange(min=1), help="Simulation processes.  [default: one a core]"
)
engine_options = _all_of(
    workers_option,
    click.option(
        "--engine",
        metavar="NAME",
        default="process",
        show_default=True,
        help="Where simulations run: process, inline, ray, or another one that is installed.",
    ),
    click.option("--address", help="Of a Ray cluster.  [default: RAY_ADDRESS, or the cluster of this machine]"),
)
