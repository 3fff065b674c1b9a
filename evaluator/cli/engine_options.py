"""``--engine``, ``--workers`` and ``--address``, as every verb that simulates has them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

__all__ = ["engine_options"]


def engine_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options to a verb, which takes ``engine``, ``workers`` and ``address``."""
    for option in (
        click.option("--address", help="Of a Ray cluster.  [default: RAY_ADDRESS, or the cluster of this machine]"),
        click.option(
            "--engine",
            metavar="NAME",
            default="process",
            show_default=True,
            help="Where simulations run: process, inline, ray, or another one that is installed.",
        ),
        click.option("--workers", type=click.IntRange(min=1), help="Simulation processes.  [default: one a core]"),
    ):
        command = option(command)
    return command
