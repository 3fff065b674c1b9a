"""The network: where, and at what angle, an end effector succeeds in a scene (paper, section 3.2).

::

    scene (N, 1, 64, 64) ──▶ scene encoder ──▶ (N, 16, 16, 16) ──┐
                                                                cross-convolution ──▶ decoder ──▶ (N, 2, 64, 64)
    end effector, turned by k ──▶ encoder ──▶ kernel (N, 16, 28, 28) ──┘                 failure, success

The end effector is turned and not the scene: a push goes to +x whatever the yaw of the hand. So the scene is encoded
once for all 16 angles, and the kernels of an end effector serve every scene. The layers are those of AdaGrasp
(arXiv:2011.14206) in two dimensions, with one more halving in the end effector's encoder: both maps have 4.5 mm a pixel
here, and a cross-convolution makes sense between maps of one scale only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import torch
from torch import Tensor, nn

from baselines.tae.correlation import cross_convolve
from rema_data.errors import InputError

__all__ = ["HEIGHT_SCALE_M", "Architecture", "Residual", "TaeNetwork"]

_WIDEST = 512
_WIDTHS = f"a multiple of 4, at most {_WIDEST}"
HEIGHT_SCALE_M = 0.05
"""A height of so much is a 1 for the network: objects and the end effector's slab are about as high."""


@dataclass(frozen=True, slots=True)
class Architecture:
    """What a network is made of; two networks with equal values have interchangeable weights.

    Attributes
    ----------
    width : int
        Channels of the widest layers; 64 is AdaGrasp's. Must be a multiple of 4.
    scene_stride, ee_stride : {4, 2}
        Pixels of the scene (end-effector) map in one cell of its features. With 4 and 2 it is a literal copy of
        AdaGrasp's layers, whose kernel is then twice as large as the scene says.
    up_align_corners : bool
        How the decoder doubles its maps: True as AdaGrasp does, which stretches them by up to 3 pixels at the border;
        False shifts all pixels alike.
    correlation_scale : {"none", "cells"}
        Whether the cross-convolution is divided by the number of cells of its kernel.
    """

    width: int = 64
    scene_stride: int = 4
    ee_stride: int = 4
    up_align_corners: bool = True
    correlation_scale: str = "none"

    def __post_init__(self) -> None:
        checks = {
            "width": (type(self.width) is int and 0 < self.width <= _WIDEST and self.width % 4 == 0, _WIDTHS),
            "scene_stride": (self.scene_stride in (2, 4), "2 or 4"),
            "ee_stride": (self.ee_stride in (2, 4), "2 or 4"),
            "up_align_corners": (isinstance(self.up_align_corners, bool), "true or false"),
            "correlation_scale": (self.correlation_scale in ("none", "cells"), "'none' or 'cells'"),
        }
        for name, (good, allowed) in checks.items():
            if not good:
                raise InputError(f"{name} = {getattr(self, name)!r} makes no network", hint=f"{name} is {allowed}")

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Architecture:
        """Inverse of ``to_dict``.

        Raises
        ------
        InputError
            A field is unknown, or its value makes no network.
        """
        unknown = sorted(set(values) - {field.name for field in fields(cls)})
        if unknown:
            raise InputError(
                f"the architecture has unknown fields: {', '.join(unknown)}",
                hint="install the version of rema that made the checkpoint",
            )
        return cls(**values)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, ready for JSON."""
        return asdict(self)


class TaeNetwork(nn.Module):
    """Two encoders, a cross-convolution and a decoder; 601,392 parameters by default.

    Parameters
    ----------
    architecture : Architecture
    generator : torch.Generator, optional
        Draws the initial weights (Kaiming-normal); by default one with the seed 0.
    """

    def __init__(self, architecture: Architecture | None = None, generator: torch.Generator | None = None) -> None:
        super().__init__()
        self.architecture = architecture or Architecture()
        self._build(self.architecture)
        random = torch.Generator().manual_seed(0) if generator is None else generator
        for layer in self.modules():
            if isinstance(layer, nn.Conv2d):
                nn.init.kaiming_normal_(layer.weight, nonlinearity="relu", generator=random)
                if layer.bias is not None:
                    nn.init.zeros_(layer.bias)

    def _build(self, architecture: Architecture) -> None:
        wide, corners = architecture.width, architecture.up_align_corners
        half, quarter = wide // 2, wide // 4
        self.scene_encoder = nn.Sequential(
            _conv(1, quarter),
            _conv(quarter, half, stride=2),
            _conv(half, wide, stride=architecture.scene_stride // 2),
            _conv(wide, wide, kernel=1),
            Residual(wide),
            Residual(wide),
            _plain(wide, quarter),
            nn.ReLU(),
        )
        halvings = [_conv(quarter, half, stride=2), _conv(half, wide, stride=2)]
        if architecture.ee_stride == 2:
            halvings = [_conv(quarter, wide, stride=2)]
        self.ee_encoder = nn.Sequential(
            _conv(4, quarter),
            *halvings,
            _plain(wide, wide, kernel=1),
            Residual(wide),
            Residual(wide),
            _plain(wide, quarter),
            nn.ReLU(),
        )
        self.decoder = nn.Sequential(
            _plain(quarter, wide),
            nn.ReLU(),
            Residual(wide),
            _conv(wide, wide),
            _Doubled(corners) if architecture.scene_stride == 4 else nn.Identity(),
            Residual(wide),
            _conv(wide, half),
            _Doubled(corners),
            Residual(half),
            _plain(half, 2, kernel=1, bias=False),
        )

    def placed(self, device: torch.device | str) -> TaeNetwork:
        """The network itself, on a device, its weights with the channels last: the faster order on a CPU."""
        return self.to(device=device, memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]

    def encode_scene(self, scene: Tensor) -> Tensor:
        """Features float (N, width / 4, 64 / scene_stride, ...) of scenes float (N, 1, 64, 64) in metres."""
        features: Tensor = self.scene_encoder(scene * (1 / HEIGHT_SCALE_M))
        return features

    def encode_end_effector(self, end_effector: Tensor) -> Tensor:
        """Kernels float (N, width / 4, S, S), S = 112 / ee_stride.

        Parameters
        ----------
        end_effector : float (N, 4, 112, 112)
            Depth (m), mask, depth (m), mask; already turned to the angle that is asked about.
        """
        kernels: Tensor = self.ee_encoder(self.scaled(end_effector))
        return kernels

    @staticmethod
    def scaled(end_effector: Tensor) -> Tensor:
        """End-effector maps as the encoder's layers see them."""
        scale = end_effector.new_tensor([1 / HEIGHT_SCALE_M, 1.0, 1 / HEIGHT_SCALE_M, 1.0])
        return end_effector * scale[:, None, None]

    def decode(self, features: Tensor, kernels: Tensor) -> Tensor:
        """Logits float (N, 2, 64, 64) of failure and success at every place, from features and kernels of N pairs."""
        correlated = cross_convolve(features, kernels)
        if self.architecture.correlation_scale == "cells":
            correlated = correlated / (kernels.shape[-1] * kernels.shape[-2])
        logits: Tensor = self.decoder(correlated)
        return logits

    def forward(self, scene: Tensor, end_effector: Tensor) -> Tensor:
        """Logits float (N, 2, 64, 64) of N scenes with their end effectors at one angle each."""
        return self.decode(self.encode_scene(scene), self.encode_end_effector(end_effector))


class Residual(nn.Module):
    """Two 3 x 3 convolutions beside an identity."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            _plain(channels, channels, bias=False),
            nn.BatchNorm2d(channels),
            nn.ReLU(),
            _plain(channels, channels, bias=False),
            nn.BatchNorm2d(channels),
        )

    def forward(self, x: Tensor) -> Tensor:
        return nn.functional.relu(self.body(x) + x)


class _Doubled(nn.Module):
    """Twice as many rows and columns, bilinear."""

    def __init__(self, align_corners: bool) -> None:
        super().__init__()
        self.align_corners = align_corners

    def forward(self, x: Tensor) -> Tensor:
        return nn.functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=self.align_corners)


def _conv(inputs: int, outputs: int, kernel: int = 3, stride: int = 1) -> nn.Sequential:
    """Convolution, batch normalisation, ReLU."""
    return nn.Sequential(_plain(inputs, outputs, kernel, stride, bias=False), nn.BatchNorm2d(outputs), nn.ReLU())


def _plain(inputs: int, outputs: int, kernel: int = 3, stride: int = 1, bias: bool = True) -> nn.Conv2d:
    """A convolution without weights yet: torch would draw them from its global generator."""
    options = {"stride": stride, "padding": kernel // 2, "bias": bias}
    made: nn.Conv2d = nn.utils.skip_init(nn.Conv2d, inputs, outputs, kernel, **options)  # type: ignore[no-untyped-call]
    return made
