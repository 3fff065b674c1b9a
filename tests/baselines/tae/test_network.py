"""The network: sizes, scale, cross-convolution, and who gets a gradient."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from baselines.tae.correlation import cross_convolve
from baselines.tae.network import Architecture, TaeNetwork
from baselines.train.validation import pixel_logits
from rema_data.errors import InputError

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
def test_what_makes_no_network_is_refused(values: dict[str, object]) -> None:
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
    scene = torch.zeros(1, 1, 32, 32)
    i, j = 11, 17
    top, left = i - size // 2, j - size // 2
    scene[..., top : top + size, left : left + size] = pattern
    peak = int(cross_convolve(scene, pattern).flatten().argmax())
    assert divmod(peak, 32) == (i, j)


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
