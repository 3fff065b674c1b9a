"""Augmentations keep the label on its spot, and say what the world itself would have shown."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from torch import Tensor

from evaluator.sim.observation import observe
from rema_data.augment import Augment, mirror, rotate, symmetry, translate, turn
from rema_data.errors import InputError
from rema_data.grid import ANGLES, PIXEL_M, SCENE_PIXELS, decode, encode, inside_valid_square, to_world
from rema_data.heights import pack_mask
from rema_data.schema import TASKS, Grip, ObjectSpec, Observation, Pinch, Placement, Shape, Situation

HEIGHT = 300
valid = st.integers(4, 59)
any_k = st.integers(0, 15)
seeds = st.integers(0, 2**32)


def planted(i: int, j: int, k: int) -> tuple[Tensor, Tensor]:
    """A scene with one pixel, and the label on it; a second step has the label beside the pixel."""
    scene = torch.zeros((2, SCENE_PIXELS, SCENE_PIXELS), dtype=torch.int16)
    scene[:, i, j] = HEIGHT
    beside = j + 1 if j < 59 else j - 1
    return scene, torch.tensor([encode(i, j, k), encode(i, beside, k)])


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def assert_on_the_pixel(scene: Tensor, action: Tensor) -> None:
    i, j, _ = decode(int(action[0]))
    assert inside_valid_square()[i, j]
    assert scene[0, i, j] == HEIGHT
    i, j, _ = decode(int(action[1]))
    assert scene[1, i, j] == 0


@settings(max_examples=40, deadline=None)
@given(valid, valid, any_k, seeds)
def test_translation_keeps_the_label_on_its_pixel(i: int, j: int, k: int, seed: int) -> None:
    scene, action = planted(i, j, k)
    before = scene.clone(), action.clone()
    moved, label = translate(scene, action, generator(seed))
    assert_on_the_pixel(moved, label)
    assert torch.equal(label % ANGLES, action % ANGLES)
    assert moved[0].count_nonzero() == 1
    assert torch.equal(scene, before[0]) and torch.equal(action, before[1])


@settings(max_examples=40, deadline=None)
@given(valid, valid, any_k, seeds)
def test_rotation_keeps_the_label_on_its_pixel(i: int, j: int, k: int, seed: int) -> None:
    scene, action = planted(i, j, k)
    moved, label = rotate(scene, action, generator(seed))
    at = decode(int(label[0]))
    assert inside_valid_square()[at[0], at[1]]
    assert moved[0, at[0], at[1]] == HEIGHT


@settings(max_examples=40, deadline=None)
@given(valid, valid, st.integers(0, 7), seeds)
def test_pairs_stay_in_their_angles(i: int, j: int, k: int, seed: int) -> None:
    scene, action = planted(i, j, k)
    _, label = rotate(scene, action, generator(seed), angles=8)
    assert (label % ANGLES < 8).all()
    same, unturned = rotate(scene, action, generator(seed), angles=torch.tensor([0, 0]))
    assert torch.equal(same, scene) and torch.equal(unturned, action)


@settings(max_examples=40, deadline=None)
@given(valid, valid, any_k)
def test_mirror_keeps_the_label_on_its_pixel(i: int, j: int, k: int) -> None:
    scene, action = planted(i, j, k)
    moved, label, _ = mirror(scene, action, [])
    assert_on_the_pixel(moved, label)
    x, y, yaw = to_world(action[0].numpy())
    mx, my, myaw = to_world(label[0].numpy())
    assert (mx, my) == (x, pytest.approx(-y))
    assert math.cos(myaw + yaw) == pytest.approx(1)


def random_scene(seed: int, steps: int = 3) -> Tensor:
    return torch.randint(0, 500, (steps, SCENE_PIXELS, SCENE_PIXELS), generator=generator(seed), dtype=torch.int16)


actions = st.lists(st.builds(encode, valid, valid, any_k), min_size=3, max_size=3).map(lambda rows: np.array(rows))


@settings(max_examples=25, deadline=None)
@given(actions, st.integers(0, 3), seeds)
def test_four_quarter_turns_are_none(rows: np.ndarray, quarters: int, seed: int) -> None:
    scene, action = random_scene(seed), torch.from_numpy(rows)
    quarter = torch.full((3,), 4 * quarters)
    turned, label = scene, action
    for _ in range(4):
        turned, label = turn(turned, label, quarter)
    assert torch.equal(turned, scene) and torch.equal(label, action)
    turned, label = turn(scene, action, quarter)
    assert torch.equal(turned, torch.rot90(scene, -quarters, (1, 2)))


@settings(max_examples=25, deadline=None)
@given(actions, seeds, st.booleans())
def test_mirroring_twice_changes_nothing(rows: np.ndarray, seed: int, pair: bool) -> None:
    scene, action = random_scene(seed), torch.from_numpy(rows)
    if pair:
        action = action // ANGLES * ANGLES + action % 8
    depth = torch.randint(0, 500, (3, 2, 112, 112), generator=generator(seed), dtype=torch.int16)
    mask = torch.from_numpy(pack_mask(depth.numpy() > 250))
    once = mirror(scene, action, [depth, mask], pair)
    twice = mirror(once[0], once[1], once[2], pair)
    for before, after in zip((scene, action, depth, mask), (twice[0], twice[1], *twice[2]), strict=True):
        assert torch.equal(before, after)
    assert (once[2][1].numpy() == pack_mask(once[2][0].numpy() > 250)).all()
    if pair:
        assert (once[1] % ANGLES < 8).all()


def test_new_places_and_angles_are_uniform() -> None:
    steps = 1000
    scene = torch.zeros((steps, 64, 64), dtype=torch.int16)
    action = torch.full((steps,), encode(5, 50, 3))
    _, label = translate(scene, action, generator(0))
    i, j, _ = decode(label.numpy())
    for place in (i, j):
        counts = np.bincount(place, minlength=64)[4:60]
        assert counts.sum() == steps
        assert stats.chisquare(counts).pvalue > 0.001
    _, label = rotate(scene, action, generator(0))
    assert stats.chisquare(np.bincount(label.numpy() % 16)).pvalue > 0.001
    _, label = rotate(scene, action, generator(0), angles=8)
    assert np.bincount(label.numpy() % 16, minlength=16).tolist()[8:] == [0] * 8


def test_generators_decide() -> None:
    scene, action = random_scene(1), torch.tensor([encode(20, 30, 3)] * 3)
    first = translate(scene, action, generator(4))
    again = translate(scene, action, generator(4))
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    other = translate(scene, action, np.random.default_rng(4))
    same = translate(scene, action, np.random.default_rng(4))
    assert torch.equal(other[1], same[1])
    state = torch.get_rng_state()
    rotate(scene, action, generator(1))
    assert torch.equal(torch.get_rng_state(), state)


def test_float_scenes_with_a_channel() -> None:
    scene, action = random_scene(2), torch.tensor([encode(20, 30, 3)] * 3)
    metres = scene[:, None].float() * 1e-4
    for function in (translate, rotate):
        whole, label = function(scene, action, generator(3))  # type: ignore[operator]
        moved, same = function(metres, action, generator(3))  # type: ignore[operator]
        assert torch.equal(moved, whole[:, None].float() * 1e-4)
        assert torch.equal(label, same)


# What the world shows of the augmented situation -------------------------------------------------------------------


def random_spec(rng: np.random.Generator, shape: Shape | None = None) -> ObjectSpec:
    shape = list(Shape)[int(rng.integers(3))] if shape is None else shape
    length, width = rng.uniform(0.08, 0.13), rng.uniform(0.02, 0.03)
    return ObjectSpec(shape, length, width, 0.0 if shape is Shape.I else 0.86 * length, 0.03)


def stick(rng: np.random.Generator) -> Grip:
    spec = ObjectSpec(Shape.I, rng.uniform(0.18, 0.2), rng.uniform(0.02, 0.03), 0.0, 0.03)
    x, y, z, yaw = rng.uniform((-0.003, 0.03, -0.012, 1.4), (0.003, 0.06, -0.005, 1.7)).tolist()
    return Grip(spec, x, y, z, yaw, spec.width_m)


def random_situation(task: str, seed: int) -> Situation:
    """The last step of a task, with anything in the hands."""
    rng = np.random.default_rng(seed)
    x, y, yaw = rng.uniform((-0.05, -0.05, 0), (0.05, 0.05, 6)).tolist()
    target = Placement(random_spec(rng), x, y, yaw)
    grips: tuple[Grip, ...] = ()
    pinch = None
    if task == "grasp_push":
        gx, gy, gyaw = rng.uniform((-0.02, -0.04, 0), (0.02, 0.04, 6)).tolist()
        grips = (Grip(random_spec(rng), gx, gy, -0.01, gyaw, 0.03),)
    if task.startswith("grasp_grasp"):
        grips = (stick(rng), stick(rng))
    if task == "grasp_grasp_push":
        px, py, pyaw, left, right = rng.uniform((-0.01, -0.02, 0, 0.15, 0.15), (0.01, 0.02, 6, 0.2, 0.2)).tolist()
        pinch = Pinch(random_spec(rng), px, py, 0.01, pyaw, left, right)
    return Situation(task, len(TASKS[task]) - 1, target, grips, pinch)


MIRROR_TURN = {Shape.I: 0.0, Shape.L: math.pi / 2, Shape.T: math.pi}
"""The mirror image in y of an object is the mirrored spec, turned so far."""


def mirrored_spec(spec: ObjectSpec) -> ObjectSpec:
    return replace(spec, length_m=spec.arm_m, arm_m=spec.length_m) if spec.shape is Shape.L else spec


def in_y(held: Any) -> Any:
    """A placement, grip or pinch mirrored in the y axis of its frame."""
    turn_rad = MIRROR_TURN[held.spec.shape]
    return replace(held, spec=mirrored_spec(held.spec), y_m=-held.y_m, yaw_rad=turn_rad - held.yaw_rad)


def in_x(held: Any) -> Any:
    """A grip or pinch mirrored in the x axis of its frame: in y, and half a turn."""
    flipped = in_y(held)
    return replace(flipped, x_m=-held.x_m, y_m=held.y_m, yaw_rad=flipped.yaw_rad + math.pi)


def mirrored(situation: Situation) -> Situation:
    """The situation in a mirror along +x. Two arms swap sides: the left hand is now the image of the right one."""
    two = situation.kind.embodiment.two_arms
    grips = tuple(in_x(grip) for grip in reversed(situation.grips)) if two else tuple(map(in_y, situation.grips))
    pinch = situation.pinch
    if pinch is not None:
        pinch = replace(in_x(pinch), left_m=pinch.right_m, right_m=pinch.left_m)
    return replace(situation, target=in_y(situation.target), grips=grips, pinch=pinch)


def tensors(seen: Observation) -> tuple[Tensor, Tensor, Tensor]:
    scene, depth = (torch.from_numpy(array.astype(np.int16))[None] for array in (seen.scene, seen.depth))
    return scene, depth, torch.from_numpy(pack_mask(seen.mask))[None]


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("seed", range(6))
def test_mirror_is_what_the_mirrored_world_shows(task: str, seed: int) -> None:
    situation = random_situation(task, seed)
    pair = symmetry(*situation.kind).pair
    action = torch.tensor([encode(20, 30, 3)])
    scene, depth, mask = tensors(observe(situation))
    image, label, (deep, allowed) = mirror(scene, action, [depth, mask], pair)
    expected = tensors(observe(mirrored(situation)))
    for got, wanted in zip((image, deep, allowed), expected, strict=True):
        assert torch.equal(got, wanted)
    assert not torch.equal(scene, image)
    assert decode(int(label[0])) == (43, 30, 5 if pair else 13)
    if task in ("grasp_push", "grasp_grasp_push"):
        assert not torch.equal(depth, deep)


def test_pairs_at_angle_zero_have_no_image() -> None:
    scene, depth, mask = tensors(observe(random_situation("grasp_grasp_push", 0)))
    action = torch.tensor([encode(20, 30, 0)])
    image, label, (deep, allowed) = mirror(scene, action, [depth, mask], pair=True)
    for got, wanted in zip((image, label, deep, allowed), (scene, action, depth, mask), strict=True):
        assert torch.equal(got, wanted)


@pytest.mark.parametrize("seed", range(8))
def test_translation_is_what_the_moved_world_shows(seed: int) -> None:
    situation = random_situation("push", seed)
    scene = tensors(observe(situation))[0]
    action = torch.tensor([encode(30, 30, 3)])
    moved, label = translate(scene, action, generator(seed))
    i, j, _ = decode(label.numpy())
    place = situation.target
    shifted = replace(place, x_m=place.x_m + (j[0] - 30) * PIXEL_M, y_m=place.y_m + (i[0] - 30) * PIXEL_M)
    expected = tensors(observe(replace(situation, target=shifted)))[0]
    # the object is whole in the first map; what leaves the map is cut off in both
    assert (moved != expected).sum() <= 2  # pixel centres on an edge


@pytest.mark.parametrize("turns", [1, 2, 3, 4, 5, 6, 8, 12, 13])
def test_rotation_is_what_the_turned_world_shows(turns: int) -> None:
    overlap = []
    for seed in range(6):
        situation = random_situation("grasp", seed)
        scene = tensors(observe(situation))[0]
        action = torch.tensor([encode(33, 30, 3)])
        turned, label = turn(scene, action, torch.tensor([turns]))
        assert int(label[0]) % 16 == (3 + turns) % 16
        (x0, y0, _), (x1, y1, _) = to_world(action[0].numpy()), to_world(label[0].numpy())
        angle = turns * 2 * math.pi / 16
        place, dx, dy = situation.target, situation.target.x_m - x0, situation.target.y_m - y0
        moved = replace(
            place,
            x_m=x1 + math.cos(angle) * dx - math.sin(angle) * dy,
            y_m=y1 + math.sin(angle) * dx + math.cos(angle) * dy,
            yaw_rad=place.yaw_rad + angle,
        )
        expected = tensors(observe(replace(situation, target=moved)))[0]
        overlap.append(((turned > 0) & (expected > 0)).sum() / ((turned > 0) | (expected > 0)).sum())
    assert min(overlap) > (0.99 if turns % 4 == 0 else 0.8)  # the bars are five pixels wide


# The composition ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Steps:
    scene: Tensor
    ee_depth: Tensor
    ee_mask: Tensor
    action: Tensor
    index: Tensor


KINDS = [TASKS[task][-1] for task in TASKS]
TABLE = {"primitive": [str(kind.primitive) for kind in KINDS], "embodiment": [str(kind.embodiment) for kind in KINDS]}


def steps(count: int = 40) -> Steps:
    """Steps of all kinds, in turn; every label lies on the only pixel of its scene."""
    seen = [tensors(observe(random_situation(task, 1))) for task in TASKS]
    index = torch.arange(count) % len(KINDS)
    rng = np.random.default_rng(0)
    i, j, k = rng.integers((4, 4, 0), (60, 60, 8), (count, 3)).T
    scene = torch.zeros((count, 64, 64), dtype=torch.int16)
    scene[torch.arange(count), torch.from_numpy(i), torch.from_numpy(j)] = HEIGHT
    _, depth, mask = (torch.cat(parts)[index] for parts in zip(*seen, strict=True))
    return Steps(scene, depth, mask, torch.from_numpy(encode(i, j, k)), index)


@pytest.mark.parametrize("mirrored", [True, False])
def test_every_step_gets_what_is_valid_for_it(mirrored: bool) -> None:
    batch = steps()
    augment = Augment(TABLE, mirror=mirrored)
    random = generator(5)
    outcomes = [augment(batch, random) for _ in range(10)]
    for row, kind in enumerate(KINDS):
        here = batch.index == row
        new = torch.cat([out.action[here] % ANGLES for out in outcomes])
        old = (batch.action[here] % ANGLES).repeat(10)
        reflected = torch.cat([(out.ee_depth[here] != batch.ee_depth[here]).flatten(1).any(1) for out in outcomes])
        two = kind.embodiment.two_arms
        if kind.primitive == "push":
            image = (8 - old) if two else (16 - old) % 16
            assert ((new == old) | ((new == image) & mirrored)).all()
            if mirrored:
                able = (image != old) & ~(two & (old == 0))
                assert 0.25 < (new != old)[able].float().mean() < 0.75
        else:
            angles = 8 if two else 16
            assert set(new.tolist()) <= set(range(angles))
            assert len(set(new.tolist())) > angles // 2
        if kind.embodiment in ("tool", "pinched"):
            still = (old == 0) & two
            assert reflected[~still].any() == mirrored
            assert not reflected[still].any()
    for out in outcomes:
        i, j, _ = decode(out.action.numpy())
        assert inside_valid_square()[i, j].all()
        assert (out.scene[torch.arange(40), torch.from_numpy(i), torch.from_numpy(j)] == HEIGHT).all()


def test_parts_can_be_left_out() -> None:
    batch = steps()
    moved = Augment(TABLE, rotate=False, mirror=False)(batch, generator(0))
    assert torch.equal(moved.action % ANGLES, batch.action % ANGLES)
    turned = Augment(TABLE, mirror=False)(batch, generator(0))
    pushes = torch.tensor([kind.primitive == "push" for kind in KINDS])[batch.index]
    assert torch.equal(turned.action[pushes] % ANGLES, batch.action[pushes] % ANGLES)
    assert not torch.equal(turned.action[~pushes] % ANGLES, batch.action[~pushes] % ANGLES)


def test_refusals() -> None:
    scene, action = planted(20, 30, 3)
    random = generator(0)
    for bad_scene, bad_action in ((scene[:, :50], action), (scene, action[:1]), (scene[:, None, None], action)):
        with pytest.raises(InputError, match="scene has the shape"):
            translate(bad_scene.expand(2, *bad_scene.shape[1:]), bad_action, random)
    with pytest.raises(InputError, match="scene has the shape"):
        rotate(torch.zeros(2, 4, 64, 64), action, random)
    with pytest.raises(InputError, match="end-effector maps have the shape"):
        mirror(scene, action, [torch.zeros(2, 4, 64, 64)])
    with pytest.raises(InputError, match="no column 'embodiment'"):
        Augment({"primitive": ["push"]})
