"""Turned end-effector maps are the maps of turned end effectors."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from baselines.tae.rotation import turn_end_effector
from evaluator.sim.observation import observe
from tests.evaluator.sim.test_cameras import SITUATIONS, iou, near, painted_at


@pytest.mark.parametrize("name", SITUATIONS)
@pytest.mark.parametrize("k", [1, 4, 6, 11])
def test_a_turned_map_is_the_map_captured_at_that_yaw(name: str, k: int) -> None:
    planes = torch.from_numpy(observe(SITUATIONS[name]).mask[:1].astype(np.float32))[None]
    turned = turn_end_effector(planes, torch.tensor([k]))[0, 0].numpy() > 0.5
    captured = painted_at(SITUATIONS[name], k * 2 * math.pi / 16)
    assert not (turned & ~near(captured)).any()
    assert not (captured & ~near(turned)).any()
    if captured.sum() > 200:  # closed fingers cover some 40 pixels, mostly edges
        assert iou(turned, captured) > (0.95 if k == 4 else 0.85)


def test_quarter_turns_move_whole_pixels() -> None:
    planes = torch.rand(1, 2, 112, 112, generator=torch.Generator().manual_seed(0))
    for quarter in range(4):
        turned = turn_end_effector(planes, torch.tensor([4 * quarter]))
        # from +x (columns) to +y (rows): the opposite sense of rot90, whose rows grow downwards
        torch.testing.assert_close(turned, torch.rot90(planes, -quarter, (2, 3)), atol=1e-5, rtol=0)


def test_every_map_gets_its_own_angle() -> None:
    planes = torch.rand(3, 4, 112, 112, generator=torch.Generator().manual_seed(1))
    k = torch.tensor([3, 0, 9])
    together = turn_end_effector(planes, k)
    for n in range(3):
        assert torch.equal(together[n : n + 1], turn_end_effector(planes[n : n + 1], k[n : n + 1]))
