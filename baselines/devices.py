"""Devices by their names: one that this machine lacks is refused before any work begins."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.util import find_spec
from typing import TYPE_CHECKING

from baselines import catalogue
from evaluator.policy.named import GROUP, kind_of
from rema_data import plugins
from rema_data.errors import InputError

if TYPE_CHECKING:
    import torch

    from baselines.rounds.planned import BlockPlan

__all__ = ["LEARNED", "check_players", "training_device"]

LEARNED = frozenset(
    name
    for name, point in plugins.installed(GROUP).items()
    if point.module == catalogue.__name__ and kind_of(name) == "learned"
)
"""The built-in policies that are networks."""
_OPENVINO = "openvino"


def training_device(name: str) -> torch.device:
    """The device of torch that a name means, tried out.

    Raises
    ------
    InputError
        There is no such device on this machine, or nothing can be computed on it.
    """
    import torch

    try:
        device = torch.device(name)
        torch.zeros(1, device=device).item()
    except (RuntimeError, AssertionError, NotImplementedError, ImportError) as error:
        what = "OpenVINO answers, but cannot train" if name == _OPENVINO else (str(error).splitlines() or [""])[0]
        raise InputError(
            f"the device {name!r} cannot be used here: {what}", hint=f"use one of: {', '.join(_usable())}", device=name
        ) from error
    return device


def check_players(blocks: Iterable[BlockPlan], where: str) -> None:
    """Raise where a learned policy of some blocks is to compute on a device that is not there.

    Raises
    ------
    InputError
    """
    for block in blocks:
        number = block.key.round
        played = f"{where}: rounds[{number}] is played on the device"
        for device in {use.device for use in block.policies if use.spec.name in LEARNED}:
            if device != _OPENVINO:
                try:
                    training_device(device)
                except InputError as error:
                    raise InputError(f"{played} {device}: {error.message}", hint=error.hint, round=number) from error
            elif find_spec(_OPENVINO) is None:
                raise InputError(
                    f"{played} openvino, and OpenVINO is not installed",
                    hint='pip install "rema[openvino]", or write device = "cpu": slower, the same answers up to '
                    "rounding",
                    round=number,
                )


def _usable() -> list[str]:
    import torch

    found = ["cpu", *(f"cuda:{n}" for n in range(torch.cuda.device_count()))]
    return [*found, "mps"] if torch.backends.mps.is_available() else found
