"""Augmentations of whole batches that keep label and picture together.

Every function returns new tensors, works on any device, and takes its random numbers from the generator ``random``, of
torch or numpy. ``scene`` is (N, 64, 64) or (N, 1, 64, 64), of any type; ``action`` int64 (N,), grid indices; other
shapes raise InputError. ``i`` is a row of the scene (world y), ``j`` a column (world x), ``k`` an angle: see
``rema_data.grid``.

========== ============ ============================ =========================================
step       end effector rotation                     mirror image in y
========== ============ ============================ =========================================
grasp      gripper      any of 16 angles             ``k`` to ``-k``, hand map upside down
grasp      two sticks   ``k`` stays in 0..7          ``k`` to ``8 - k``, hand map left to right
push       one hand     none: +x is its direction    ``k`` to ``-k``, hand map upside down
push       pinched      none                         ``k`` to ``8 - k``, hand map left to right
========== ============ ============================ =========================================

Two hands: a half turn of the pair is not the same pair, because each hand holds a stick of its own; so the angle stays
in 0..7, where the arms do not cross. A mirror image swaps the arms, so the pair's frame (from the right hand's stick to
the left hand's) is turned round too: that makes ``8 - k`` of ``-k``, and left to right of upside down. For ``k = 0`` it
would leave 0..7, and such steps are left as they are.

What an augmented step says is true of the geometry. Whether an arm reaches depends on the place, and is not part of it;
the paper translates nevertheless, and found it crucial. The mirror image of an I or a T is one again; that of an L has
the lengths of its bars swapped, which the world itself does not make.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor

from rema_data.errors import InputError
from rema_data.grid import ANGLES, EE_PIXELS, SCENE_PIXELS, VALID_MARGIN
from rema_data.samplers.source import source_of
from rema_data.samplers.strata import column_of
from rema_data.schema import Embodiment, Primitive, StepKind

__all__ = ["Augment", "Random", "Symmetry", "mirror", "rotate", "symmetry", "translate", "turn"]

Random = torch.Generator | np.random.Generator
Batch = TypeVar("Batch", bound=Any)

_FIRST, _LAST = VALID_MARGIN, SCENE_PIXELS - VALID_MARGIN - 1  # rows and columns that may be acted on
_CENTRE = (SCENE_PIXELS - 1) / 2
_COSINES = tuple(round(math.cos(2 * math.pi * k / ANGLES), 15) for k in range(ANGLES))  # quarter turns are exact
_SINES = tuple(round(math.sin(2 * math.pi * k / ANGLES), 15) for k in range(ANGLES))


class Symmetry(NamedTuple):
    """What may be done to a kind of step."""

    angles: int  # among which a new yaw may be drawn; 0 where the step has a direction
    pair: bool  # whether a mirror image swaps two hands


def symmetry(primitive: str, embodiment: str) -> Symmetry:
    """What may be done to steps of this kind."""
    kind = StepKind(Primitive(primitive), Embodiment(embodiment))
    return Symmetry(0 if kind.primitive is Primitive.PUSH else kind.angles, kind.embodiment.two_arms)


def translate(scene: Tensor, action: Tensor, random: Random) -> tuple[Tensor, Tensor]:
    """Move every scene by whole pixels, and its label with it, to a uniformly drawn place of the valid square.

    Pixels that are vacated become 0, the table; what leaves the map is lost. Angles and end-effector maps do not
    change.
    """
    _check(scene, action)
    i, j, k = _decode(action)
    chance = _uniform(random, 2 * len(action), action.device).view(2, -1)
    moved = _FIRST + (chance * (_LAST - _FIRST + 1)).long()
    rows, columns = (_axis(place - new, scene.device) for place, new in zip((i, j), moved, strict=True))
    return _sample(scene, rows[:, :, None], columns[:, None, :]), _encode(moved[0], moved[1], k)


def rotate(scene: Tensor, action: Tensor, random: Random, angles: int | Tensor = ANGLES) -> tuple[Tensor, Tensor]:
    """Turn every scene so that its label gets a uniformly drawn angle, as ``turn`` does.

    Not for pushes: their direction is +x of the world whatever the yaw. ``angles``, a number or int64 (N,), is 16 for
    one hand, 8 for two, and 0 to leave a step as it is: see ``symmetry``.
    """
    _check(scene, action)
    k = action % ANGLES
    allowed = torch.as_tensor(angles, device=action.device).expand_as(action)
    wanted = (_uniform(random, len(action), action.device) * allowed).long()
    return turn(scene, action, torch.where(allowed > 0, wanted - k, 0))


def turn(scene: Tensor, action: Tensor, turns: Tensor) -> tuple[Tensor, Tensor]:
    """Turn scenes, and labels with them, by ``turns`` (int64 (N,)) sixteenths of a full turn, from +x to +y.

    The label's pixel turns about the middle of the map, to the nearest pixel inside the valid square, and the scene
    turns with it as a rigid whole, so that the label stays on the same spot of the object. Quarter turns move whole
    pixels; other turns take the nearest pixel, which keeps edges sharp. Pixels from outside of the map become 0.
    """
    _check(scene, action)
    i, j, k = _decode(action)
    step = turns % ANGLES
    cosine, sine = (
        torch.tensor(table, dtype=torch.float32, device=action.device)[step] for table in (_COSINES, _SINES)
    )
    x, y = j - _CENTRE, i - _CENTRE
    column = (cosine * x - sine * y + _CENTRE).round().long().clamp(_FIRST, _LAST)
    row = (sine * x + cosine * y + _CENTRE).round().long().clamp(_FIRST, _LAST)
    dy, dx = _axis(-row, scene.device)[:, :, None], _axis(-column, scene.device)[:, None, :]
    cosine, sine = cosine[:, None, None], sine[:, None, None]
    source_rows = (cosine * dy - sine * dx).round_() + i[:, None, None]
    source_columns = (cosine * dx + sine * dy).round_() + j[:, None, None]
    return _sample(scene, source_rows, source_columns), _encode(row, column, (k + turns) % ANGLES)


def mirror(
    scene: Tensor,
    action: Tensor,
    maps: Sequence[Tensor],
    pair: bool | Tensor = False,
    chosen: bool | Tensor = True,
) -> tuple[Tensor, Tensor, list[Tensor]]:
    """Mirror images in y: the world as a mirror along +x shows it.

    ``maps`` are end-effector maps, (N, ..., 112, 112) or packed uint8 (N, ..., 112, 14); they come back as a list.
    ``pair`` and ``chosen``, a truth value or bool (N,), tell where two hands act as one, and which steps to mirror: the
    others, and pairs at ``k = 0``, are left as they are.
    """
    _check(scene, action)
    for planes in maps:
        if planes.shape[0] != len(action) or tuple(planes.shape[-2:]) not in _MAP_SHAPES:
            raise InputError(
                f"end-effector maps have the shape {tuple(planes.shape)}",
                hint=f"give {len(action)} maps of {EE_PIXELS} x {EE_PIXELS} pixels, packed or not",
            )
    i, j, k = _decode(action)
    two = torch.as_tensor(pair, device=action.device).expand_as(action)
    flip = torch.as_tensor(chosen, device=action.device).expand_as(action) & ~(two & (k == 0))
    angle = torch.where(two, ANGLES // 2 - k, -k) % ANGLES
    label = torch.where(flip, _encode(SCENE_PIXELS - 1 - i, j, angle), action)
    one_hand, two_hands = (flip & ~two).nonzero()[:, 0], (flip & two).nonzero()[:, 0]
    mirrored = [_replaced(_replaced(planes, one_hand, _upside_down), two_hands, _left_to_right) for planes in maps]
    return _replaced(scene, flip.nonzero()[:, 0], _upside_down), label, mirrored


class Augment:
    """What a training loop does to every batch: mirrors pushes, rotates grasps and translates everything.

    Parameters
    ----------
    table : dataset or table
        With the columns ``primitive`` and ``embodiment``; a batch's ``index`` are its rows.
    rotate : bool
        Turn grasps.
    mirror : bool
        Mirror pushes, half of the time. Grasps have their rotations.

    Raises
    ------
    InputError
        A column is missing.

    Examples
    --------
    ::

        augment = Augment(dataset)
        random = torch.Generator().manual_seed(0)
        for batch in loader:
            batch = augment(batch.to("cuda"), random)
    """

    def __init__(self, table: Any, *, rotate: bool = True, mirror: bool = True) -> None:
        columns = source_of(table).table
        kinds = [column_of(columns, name).astype("category").cat for name in ("primitive", "embodiment")]
        codes = [np.asarray(kind.codes, np.int64) for kind in kinds]
        choices = [[symmetry(p, e) for e in kinds[1].categories] for p in kinds[0].categories]
        angles, pair = (
            np.array([[entry[field] for entry in row] for row in choices], np.int64)[codes[0], codes[1]]
            for field in range(2)
        )
        self._rotates = rotate and bool((angles > 0).any())
        self._mirrors = mirror and bool((angles == 0).any())
        self._kinds = torch.from_numpy(np.stack([angles, pair], axis=1).astype(np.int8))

    def __call__(self, batch: Batch, random: Random) -> Batch:
        """A new batch; on the CPU, ``random`` draws the same for every device."""
        scene, action = batch.scene, batch.action
        self._kinds = self._kinds.to(batch.index.device)
        angles, pair = self._kinds[batch.index].long().unbind(1)
        changed: dict[str, Tensor] = {}
        if self._mirrors:
            names = ["end_effector"] if hasattr(batch, "end_effector") else ["ee_depth", "ee_mask"]
            chosen = (angles == 0) & (_uniform(random, len(action), action.device) < 0.5)
            maps = [getattr(batch, name) for name in names]
            scene, action, maps = mirror(scene, action, maps, pair > 0, chosen)
            changed.update(zip(names, maps, strict=True))
        if self._rotates:
            scene, action = rotate(scene, action, random, angles)
        scene, action = translate(scene, action, random)
        return dataclasses.replace(batch, scene=scene, action=action, **changed)


_PACKED = EE_PIXELS // 8
_MAP_SHAPES = ((EE_PIXELS, EE_PIXELS), (EE_PIXELS, _PACKED))


def _check(scene: Tensor, action: Tensor) -> None:
    square = tuple(scene.shape[1:]) in ((SCENE_PIXELS, SCENE_PIXELS), (1, SCENE_PIXELS, SCENE_PIXELS))
    if not square or action.shape != scene.shape[:1]:
        raise InputError(
            f"scene has the shape {tuple(scene.shape)}, action {tuple(action.shape)}",
            hint=f"give (N, {SCENE_PIXELS}, {SCENE_PIXELS}) or (N, 1, {SCENE_PIXELS}, {SCENE_PIXELS}), and (N,)",
        )


def _encode(i: Tensor, j: Tensor, k: Tensor) -> Tensor:
    """``rema_data.grid.encode`` for tensors."""
    return (i * SCENE_PIXELS + j) * ANGLES + k


def _decode(action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """``rema_data.grid.decode`` for tensors."""
    cell = action // ANGLES
    return cell // SCENE_PIXELS, cell % SCENE_PIXELS, action % ANGLES


def _uniform(random: Random, count: int, device: torch.device) -> Tensor:
    """Float64 (count,) in [0, 1)."""
    if isinstance(random, torch.Generator):
        return torch.rand(count, generator=random, device=random.device, dtype=torch.float64).to(device)
    return torch.from_numpy(random.random(count)).to(device)


def _axis(offset: Tensor, device: torch.device) -> Tensor:
    """Source of every pixel along an axis, int64 (N, 64)."""
    return torch.arange(SCENE_PIXELS, device=device) + offset[:, None]


def _sample(scene: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Every pixel from its source, 0 where that is outside; sources are whole numbers and broadcast to (N, 64, 64)."""
    last = SCENE_PIXELS - 1
    inside = (rows >= 0) & (rows <= last) & (columns >= 0) & (columns <= last)
    source = (rows.clamp(0, last) * SCENE_PIXELS + columns.clamp(0, last)).long()
    pixels = scene.reshape(len(scene), -1).gather(1, source.reshape(len(scene), -1))
    return (pixels * inside.reshape(len(scene), -1).to(pixels.dtype)).view(scene.shape)


def _replaced(planes: Tensor, rows: Tensor, change: Callable[[Tensor], Tensor]) -> Tensor:
    """The tensor with some of its rows changed."""
    if not len(rows):
        return planes
    return planes.index_copy(0, rows, change(planes.index_select(0, rows)))


def _upside_down(planes: Tensor) -> Tensor:
    return planes.flip(-2)


def _left_to_right(planes: Tensor) -> Tensor:
    flipped = planes.flip(-1)
    if planes.shape[-1] != _PACKED:
        return flipped
    for shift, mask in ((4, 0x0F), (2, 0x33), (1, 0x55)):  # reverse the bits of every byte
        flipped = ((flipped >> shift) & mask) | ((flipped & mask) << shift)
    return flipped
