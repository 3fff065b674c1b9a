"""The network: sizes, scale, cross-convolution, and who gets a gradient."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy import ndimage
from torch import Tensor

from baselines.tae.correlation import cross_convolve
from baselines.tae.network import Architecture, TaeNetwork
from baselines.tae.rotation import turn_end_effector
from baselines.train.validation import pixel_logits
from rema_data.errors import InputError
from rema_data.grid import ANGLES

SMALL = Architecture(width=8)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def parameters(module: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def test_as_many_parameters_as_the_published_layers() -> None:
    network = TaeNetwork()
    parts = (network.scene_encoder, network.ee_encoder, network.decoder)
    assert [parameters(part) for part in parts] == [184_832, 185_200, 231_360]
    assert parameters(TaeNetwork(Architecture(ee_stride=2))) == 587_504


@pytest.mark.parametrize("architecture", [SMALL, Architecture(8, 4, 2), Architecture(8, 2, 2), Architecture(8, 2, 4)])
def test_maps_come_out_in_the_scene_s_pixels(architecture: Architecture) -> None:
    network = TaeNetwork(architecture, generator()).eval()
    scene, hand = torch.rand(2, 1, 64, 64) * 0.05, torch.rand(2, 4, 112, 112)
    assert network.encode_scene(scene).shape == (2, 2, *(64 // architecture.scene_stride,) * 2)
    assert network.encode_end_effector(hand).shape == (2, 2, *(112 // architecture.ee_stride,) * 2)
    assert network(scene, hand).shape == (2, 2, 64, 64)


@pytest.mark.parametrize(
    "values", [{"width": 6}, {"ee_stride": 3}, {"correlation_scale": "half"}, {"up_align_corners": 1}, {"depth": 3}]
)
def test_impossible_architectures_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(InputError) as caught:
        Architecture.from_dict(values)
    assert caught.value.hint


def test_an_architecture_is_kept() -> None:
    assert Architecture.from_dict(Architecture(16, 2, 4, False, "cells").to_dict()) == Architecture(
        16, 2, 4, False, "cells"
    )


def test_initial_weights_come_from_the_generator_alone() -> None:
    one, two, other = (TaeNetwork(SMALL, generator(seed)).state_dict() for seed in (0, 0, 1))
    assert all(torch.equal(one[name], two[name]) for name in one)
    assert any(not torch.equal(one[name], other[name]) for name in one)


def looped(features: Tensor, kernels: Tensor) -> Tensor:
    """The same, one sample, channel and shift after the other, in numpy."""
    size, (height, width) = kernels.shape[-1], features.shape[-2:]
    out = np.zeros(features.shape)
    padded = np.pad(features.double().numpy(), ((0, 0), (0, 0), (size, size), (size, size)))
    for u in range(size):
        for v in range(size):
            rows, columns = size + u - size // 2, size + v - size // 2
            window = padded[:, :, rows : rows + height, columns : columns + width]
            out += window * kernels[:, :, u, v].double().numpy()[..., None, None]
    return torch.from_numpy(out)


@pytest.mark.parametrize("size", [5, 6, 28])
def test_one_grouped_convolution_is_the_loop(size: int) -> None:
    features, kernels = torch.rand(3, 2, 16, 16, generator=generator()), torch.rand(3, 2, size, size)
    torch.testing.assert_close(
        cross_convolve(features, kernels).double(), looped(features, kernels), atol=1e-4, rtol=1e-5
    )


@pytest.mark.parametrize("size", [7, 8])
def test_a_planted_pattern_peaks_where_it_was_planted(size: int) -> None:
    """A kernel answers loudest where the scene looks like it, at the cell on which its own middle lies."""
    pattern = torch.rand(1, 1, size, size, generator=generator(3))
    scene = planted(pattern, (11, 17))
    assert divmod(int(cross_convolve(scene, pattern).flatten().argmax()), CELLS) == (11, 17)


@pytest.mark.parametrize("size", [7, 28])
@pytest.mark.parametrize("k", [0, 3, 4, 6, 9, 13])
def test_a_planted_pattern_peaks_at_the_angle_at_which_it_was_planted(size: int, k: int) -> None:
    """Among all places and all angles; what is planted was turned by another program than the network's."""
    cells = torch.randn(1, 1, 7, 7, generator=generator(4))
    axis = torch.arange(112) - 55.5
    disc = (axis[:, None] ** 2 + axis**2 < 50**2).double()
    smooth = torch.nn.functional.interpolate(cells, size=112, mode="bilinear", align_corners=False)[0, 0].double()
    pattern = disc * (smooth - (smooth * disc).sum() / disc.sum())  # no mean: what differs is not loud anywhere

    def kernel(turned: Tensor) -> Tensor:
        return torch.nn.functional.avg_pool2d(turned, 112 // size)

    # From +x (columns) to +y (rows), which grow downwards.
    turned = ndimage.rotate(pattern.numpy(), -k * 360 / ANGLES, reshape=False, order=1)
    scene = planted(kernel(torch.from_numpy(turned).float()[None, None]), (19, 26))
    every = turn_end_effector(pattern.float().expand(ANGLES, 1, -1, -1), torch.arange(ANGLES))
    answers = cross_convolve(scene.expand(ANGLES, -1, -1, -1), kernel(every))
    peak_k, cell = divmod(int(answers.flatten().argmax()), CELLS * CELLS)
    assert (*divmod(cell, CELLS), peak_k) == (19, 26, k)


CELLS = 48


def planted(pattern: Tensor, place: tuple[int, int]) -> Tensor:
    """A scene with nothing but a pattern, its middle at a cell."""
    size = pattern.shape[-1]
    top, left = (at - size // 2 for at in place)
    scene = torch.zeros(1, 1, CELLS, CELLS)
    scene[..., top : top + size, left : left + size] = pattern
    return scene


def test_only_the_labelled_pixel_gets_a_gradient() -> None:
    logits = torch.rand(3, 2, 64, 64, requires_grad=True)
    pixel = torch.tensor([0, 65, 4095])
    loss = torch.nn.functional.cross_entropy(pixel_logits(logits, pixel), torch.tensor([0, 1, 1]))
    (gradient,) = torch.autograd.grad(loss, logits)
    touched = {(n, i * 64 + j) for n, _, i, j in gradient.nonzero().tolist()}
    assert touched == {(0, 0), (1, 65), (2, 4095)}
    assert (gradient.flatten(2).sum(1).abs() < 1e-6).all()  # what success gains, failure loses


def test_evaluation_mode_is_near_training_mode() -> None:
    """After the running statistics have settled on the data, both modes say nearly the same."""
    network = TaeNetwork(SMALL, generator()).train()
    scene, hand = torch.rand(8, 1, 64, 64, generator=generator(1)) * 0.05, torch.rand(8, 4, 112, 112)
    with torch.no_grad():
        for _ in range(60):
            trained = network(scene, hand)
        settled = network.eval()(scene, hand)
    gap = (trained - settled).abs().mean() / trained.std()
    assert gap < 0.1
