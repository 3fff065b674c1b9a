"""Kernels of end effectors from the part of their maps that is not empty.

Most of an end-effector map is empty, and what the layers make of emptiness is always the same. So it is computed once,
and every layer works on a window: where its input is not that of an empty map. The window grows by what the layer's
kernel reaches. The sums are those of the whole map.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.tae.network import Residual, TaeNetwork
from rema_data.grid import EE_PIXELS

__all__ = ["WindowedEncoder"]

_STEP = 16
"""Sides of windows in the map are multiples of so many pixels: torch prepares a convolution for every new size."""
_MOST = 64
"""The largest side of a window in the map: beyond it the whole map is as soon done."""


@dataclass(frozen=True, slots=True)
class _Layer:
    """A convolution, whether the output of an earlier layer is added to its own, and whether a ReLU follows."""

    conv: nn.Conv2d
    rectified: bool
    added: int | None = None  # the layer whose input is added


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """Squares of N maps that differ from an empty one: values (N, C, side, side), first rows and columns (N, 2)."""

    values: Tensor
    starts: list[tuple[int, int]]

    @property
    def side(self) -> int:
        return int(self.values.shape[-1])


class WindowedEncoder:
    """What ``TaeNetwork.encode_end_effector`` gives, sooner.

    Parameters
    ----------
    network : TaeNetwork
        In evaluation mode, without batch normalisations (``baselines.tae.scoring.folded``), on its device.
    """

    def __init__(self, network: TaeNetwork) -> None:
        self._network = network
        self._layers = list(_layers(network.ee_encoder))
        weights = self._layers[0].conv.weight
        empty = weights.new_zeros(1, weights.shape[1], EE_PIXELS, EE_PIXELS)
        self._empty = [empty]  # the input of every layer for an empty map, and the last one's output
        with torch.inference_mode():
            for number, layer in enumerate(self._layers):
                out = layer.conv(self._empty[number])
                self._empty.append(_finished(layer, out, None if layer.added is None else self._empty[layer.added]))
        self._padded = [
            functional.pad(values, [layer.conv.padding[0]] * 4)  # type: ignore[list-item]
            for layer, values in zip(self._layers, self._empty, strict=False)
        ]

    def __call__(self, end_effector: Tensor) -> Tensor:
        """Kernels (N, C, S, S) of end effectors float32 (N, 4, 112, 112), in metres and turned already."""
        now = self._shown(end_effector)
        if now is None:
            dtype = self._empty[0].dtype
            return self._network.encode_end_effector(end_effector.to(dtype, memory_format=torch.channels_last))
        inputs: list[_Windows] = []
        for number, layer in enumerate(self._layers):
            inputs.append(now)
            now = self._applied(number, layer, now, inputs)
        whole = self._empty[-1].expand(len(end_effector), -1, -1, -1).clone(memory_format=torch.channels_last)
        return _pasted(whole, now, [(0, 0)] * len(end_effector))

    def _shown(self, maps: Tensor) -> _Windows | None:
        """The squares of maps outside of which all are 0, of one size and scaled; None where they are too large."""
        shown = maps.amax(dim=1) > 0
        spans = []
        for axis in (2, 1):  # of rows, of columns
            there = shown.any(dim=axis).to(torch.uint8)
            first, last = there.argmax(dim=1), there.shape[1] - 1 - there.flip(1).argmax(dim=1)
            spans.append((first.tolist(), last.tolist()))
        needed = max(last - first + 1 for ends in spans for first, last in zip(*ends, strict=True))
        side = -(-needed // _STEP) * _STEP
        if side > _MOST:
            return None
        last = EE_PIXELS - side
        starts = [(min(row, last), min(column, last)) for row, column in zip(spans[0][0], spans[1][0], strict=True)]
        cut = [maps[n : n + 1, :, r : r + side, c : c + side] for n, (r, c) in enumerate(starts)]
        squares = torch.cat(cut).to(self._empty[0].dtype, memory_format=torch.channels_last)
        return _Windows(self._network.scaled(squares), starts)

    def _applied(self, number: int, layer: _Layer, given: _Windows, inputs: list[_Windows]) -> _Windows:
        conv, empty = layer.conv, self._padded[number]
        reach, stride = conv.kernel_size[0] // 2, conv.stride[0]
        most = self._empty[number + 1].shape[-1]
        # The outputs that see a pixel of the window: the first is that whose kernel ends there.
        firsts = [tuple((start - reach + stride - 1) // stride for start in pair) for pair in given.starts]
        longest = max(
            (start + given.side - 1 + reach) // stride - first + 1
            for pair, found in zip(given.starts, firsts, strict=True)
            for start, first in zip(pair, found, strict=True)
        )
        side = min(most, longest)
        starts = [(min(max(row, 0), most - side), min(max(column, 0), most - side)) for row, column in firsts]
        wanted = (side - 1) * stride + 2 * reach + 1
        corners = [(row * stride, column * stride) for row, column in starts]  # in the padded map
        around = _cut(empty, corners, wanted)
        filled = _pasted(around, given, [(row - reach, column - reach) for row, column in corners])
        out = functional.conv2d(filled, conv.weight, conv.bias, conv.stride)
        before = None
        if layer.added is not None:
            before = _pasted(_cut(self._empty[layer.added], starts, side), inputs[layer.added], starts)
        return _Windows(_finished(layer, out, before), starts)


def _layers(encoder: nn.Sequential) -> list[_Layer]:
    """The convolutions of an encoder in order."""
    found: list[_Layer] = []
    for part in encoder:
        if isinstance(part, nn.Conv2d):
            found.append(_Layer(part, rectified=False))
        elif isinstance(part, nn.ReLU):
            found[-1] = _Layer(found[-1].conv, rectified=True)
        elif isinstance(part, nn.Sequential):
            found += _layers(part)
        elif isinstance(part, Residual):  # its input is added before the last ReLU
            first = len(found)
            found += _layers(part.body)
            found[-1] = _Layer(found[-1].conv, rectified=True, added=first)
    return found


def _finished(layer: _Layer, out: Tensor, before: Tensor | None) -> Tensor:
    if before is not None:
        out = out + before
    return functional.relu(out) if layer.rectified else out


def _cut(values: Tensor, starts: list[tuple[int, int]], side: int) -> Tensor:
    """Squares (N, C, side, side) of one map (1, C, H, W)."""
    cut = [values[:, :, row : row + side, column : column + side] for row, column in starts]
    return torch.cat(cut).contiguous(memory_format=torch.channels_last)


def _pasted(squares: Tensor, windows: _Windows, origins: list[tuple[int, int]]) -> Tensor:
    """The squares, which begin at ``origins`` of the maps, with the windows in their places."""
    for n, ((row, column), (top, left)) in enumerate(zip(windows.starts, origins, strict=True)):
        squares[n, :, row - top : row - top + windows.side, column - left : column - left + windows.side] = (
            windows.values[n]
        )
    return squares
