"""Devices by their names: one that this machine lacks is refused before any work begins."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

from baselines import catalogue
from evaluator.policy.named import GROUP, kind_of
from rema_data import plugins
from rema_data.errors import InputError

if TYPE_CHECKING:
    import torch

__all__ = ["LEARNED", "inference_device", "training_device"]

LEARNED = frozenset(
    name
    for name, point in plugins.installed(GROUP).items()
    if point.module == catalogue.__name__ and kind_of(name) == "learned"
)
"""The built-in policies that are networks."""
_OPENVINO = "openvino"


def training_device(name: str) -> torch.device:
    """The device of torch that a name means, tried out; InputError where it is not there or cannot compute."""
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


def inference_device(name: str) -> None:
    """Raise an InputError where a network cannot be asked on a device of that name."""
    if name != _OPENVINO:
        training_device(name)
    elif find_spec(_OPENVINO) is None:
        hint = 'pip install "rema[openvino]", or write device = "cpu": slower, the same answers up to rounding'
        raise InputError("OpenVINO is not installed", hint=hint, device=name)


def _usable() -> list[str]:
    import torch

    found = ["cpu", *(f"cuda:{n}" for n in range(torch.cuda.device_count()))]
    return [*found, "mps"] if torch.backends.mps.is_available() else found
