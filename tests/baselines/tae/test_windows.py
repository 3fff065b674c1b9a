"""What is computed in windows is what the whole map gives."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines.tae.network import Architecture, TaeNetwork
from baselines.tae.scoring import folded
from baselines.tae.windows import WindowedEncoder
from rema_data.grid import EE_PIXELS
from tests.baselines.tae.test_scoring import settled

RECTANGLES = st.tuples(*[st.integers(0, EE_PIXELS - 1)] * 2, *[st.integers(0, 70)] * 2)


def shown(rectangles: list[tuple[int, int, int, int]]) -> torch.Tensor:
    """A map for each rectangle (first row, first column, height, width), of heights that differ from pixel to pixel."""
    maps = torch.zeros(len(rectangles), 4, EE_PIXELS, EE_PIXELS)
    for values, (row, column, height, width) in zip(maps, rectangles, strict=True):
        part = values[:, row : row + height, column : column + width]
        part.copy_(torch.linspace(0.01, 0.05, part.numel()).reshape(part.shape))
    return maps


@pytest.fixture(scope="module", params=[4, 2], ids=["18 mm", "9 mm"])
def network(request: pytest.FixtureRequest) -> TaeNetwork:
    """A network whose layers have their biases, so that emptiness is not 0 after the first one."""
    made = settled(0) if request.param == 4 else TaeNetwork(Architecture(scene_stride=2, ee_stride=2))
    for layer in made.modules():
        if isinstance(layer, torch.nn.BatchNorm2d):
            torch.nn.init.normal_(layer.bias, generator=torch.Generator().manual_seed(1))
    return folded(made).placed("cpu")


@settings(max_examples=25, deadline=None)
@given(rectangles=st.lists(RECTANGLES, min_size=1, max_size=3))
def test_kernels_are_those_of_the_whole_maps(network: TaeNetwork, rectangles: list[tuple[int, int, int, int]]) -> None:
    maps = shown(rectangles)
    with torch.inference_mode():
        whole, found = network.encode_end_effector(maps), WindowedEncoder(network)(maps)
    torch.testing.assert_close(found, whole, rtol=1e-4, atol=1e-4 * float(whole.abs().max()))


@pytest.mark.parametrize(("size", "windowed"), [(0, False), (1, True), (64, True), (65, False), (112, False)])
def test_a_map_that_is_almost_full_is_encoded_whole(
    network: TaeNetwork, size: int, windowed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    encoder, asked = WindowedEncoder(network), []
    real = network.encode_end_effector
    monkeypatch.setattr(network, "encode_end_effector", lambda maps: (asked.append(len(maps)), real(maps))[1])
    with torch.inference_mode():
        encoder(shown([(0, 0, size, size)]))
    assert asked == ([] if windowed else [1])
