"""Small synthetic releases, for tests of code that reads one. They need no simulator; nothing in them is physics."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rema_data.grid import EE_PIXELS, SCENE_PIXELS, encode
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import Manifest
from rema_data.release.seal import Description, seal
from rema_data.schema import (
    TASK_NUMBERS,
    TASKS,
    Action,
    Episode,
    Failure,
    Grip,
    ObjectSpec,
    Observation,
    Pinch,
    Placement,
    Shape,
    Situation,
    Step,
    StepOutcome,
)
from rema_data.store.block import BlockKey, BlockWriter, encode_episodes
from rema_data.store.columns import VARIATION, version_with
from rema_data.variation import Displacement, Sense, Variation

__all__ = ["FINGERPRINT", "make_block", "make_release", "synthetic_episode"]

FINGERPRINT = {"pybullet": "0.0.0", "parameters": "0" * 64, "probe": "0" * 64}
_DIGEST = "1" * 64
_CHUNK = 256


def _spec(rng: np.random.Generator) -> ObjectSpec:
    shape = list(Shape)[int(rng.integers(3))]
    length, width = float(rng.uniform(0.08, 0.14)), float(rng.uniform(0.02, 0.03))
    return ObjectSpec(shape, length, width, 0.0 if shape is Shape.I else length * 0.7, 0.03)


def _rectangle(rng: np.random.Generator, size: int, height: int) -> np.ndarray:
    plane = np.zeros((size, size), np.uint16)
    row, column = (int(value) for value in rng.integers(8, size - 24, 2))
    plane[row : row + int(rng.integers(4, 16)), column : column + int(rng.integers(4, 16))] = height
    return plane


def _observation(rng: np.random.Generator, bare: bool) -> Observation:
    """Boxes on a table; a bare gripper always looks the same."""
    hand = np.random.default_rng(0) if bare else rng
    depth = np.stack([_rectangle(hand, EE_PIXELS, 500) for _ in range(2)])
    return Observation(_rectangle(rng, SCENE_PIXELS, 300), depth, depth > 0)


def _variation(index: int) -> Variation:
    """Some variation of an episode: those of three varied episodes have every part that a release may hold."""
    spec = ObjectSpec(Shape.L, 0.1, 0.02, 0.07, 0.03)
    post = Placement(ObjectSpec(Shape.I, 0.03, 0.03, 0.0, 0.06), 0.02, -0.06, 0.5)
    parts: tuple[dict[str, Any], ...] = (
        {"axis": "clutter", "others": (Placement(spec, 0.05, 0.06, 1.0), Placement(spec, -0.05, 0.06, 2.0))},
        {"axis": "shape", "act": Displacement(0.001, -0.002, 0.03), "register": Displacement(0.002)},
        {
            "axis": "mixed",
            "sense": Sense(2**61 + index, 0.0025, 0.5, 2),
            "posts": (post,),
            "mass_offset_m": (0.01, 0.0),
        },
    )
    return Variation(level=1, base=index, world=(("object_friction", 0.35),), **parts[index // 2 % 3])


def synthetic_episode(key: BlockKey, index: int, seed: int = 0, success: float = 0.3, varied: bool = False) -> Episode:
    """An episode as a function of its arguments: steps succeed with probability ``success``, tool picks mostly.

    With ``varied``, every second one has a variation.
    """
    variation = _variation(index) if varied and index % 2 else None
    path = (seed, key.round, TASK_NUMBERS[key.task], key.split == "val", index)
    rng = np.random.default_rng(np.random.SeedSequence(path))
    steps: list[Step] = []
    grips: tuple[Grip, ...] = ()
    pinch: Pinch | None = None
    for number, kind in enumerate(TASKS[key.task]):
        x_m, y_m, yaw_rad = rng.uniform((-0.1, -0.1, 0.0), (0.1, 0.1, 6.0)).tolist()
        spec = _spec(rng)
        last = number == len(TASKS[key.task]) - 1
        if variation is not None and last:
            spec = ObjectSpec(Shape.U, spec.length_m, spec.width_m, spec.length_m * 0.7, spec.height_m)
        place = Placement(spec, x_m, y_m, yaw_rad)
        situation = Situation(key.task, number, place, grips, pinch, variation if last else None)
        action = encode(*(int(value) for value in (*rng.integers(4, 60, 2), rng.integers(kind.angles))))
        won = bool(rng.random() < (success if situation.last else 0.9))
        failure = None if won else (Failure.MISSED, Failure.BLOCKED, Failure.SLIPPED)[int(rng.integers(3))]
        far, high = (0.15, 0.3) if won else (0.0, 0.0)
        steps_taken = int(rng.integers(1, 300))
        outcome = StepOutcome(won, failure, arm="left", displacement_m=far, lift_m=high, sim_steps=steps_taken)
        seen = _observation(rng, kind.embodiment.bare)
        name = "random" if situation.last else "reference"
        steps.append(Step(situation, seen, Action(int(action)), outcome, name, _DIGEST))
        if not won:
            break
        if kind.makes == "tool":
            grips = (*grips, Grip(place.spec, 0.0, 0.004, -0.01, 1.5, place.spec.width_m))
        elif kind.makes == "pinch" and not situation.last:
            pinch = Pinch(place.spec, 0.0, 0.0, 0.0, 0.5, 0.1, 0.1)
    return Episode(key.task, key.round, key.split, index, seed, tuple(steps), variation)


def make_block(
    folder: Path, key: BlockKey, episodes: int, seed: int = 0, success: float = 0.3, varied: bool = False
) -> None:
    """Write a synthetic block of so many episodes into ``folder``."""
    version = version_with(*([VARIATION] if varied else []))
    writer = BlockWriter(folder)
    for start in range(0, episodes, _CHUNK):
        stop = min(start + _CHUNK, episodes)
        made = [synthetic_episode(key, n, seed, success, varied) for n in range(start, stop)]
        writer.append(*encode_episodes(made, version))
    writer.close()


def make_release(
    root: Path,
    name: str = "tiny",
    tasks: Sequence[str] = ("grasp", "grasp_push"),
    rounds: Iterable[int] = (1,),
    episodes: int = 20,
    seed: int = 0,
    success: float = 0.3,
    parent: Manifest | None = None,
    reused: Sequence[BlockKey] = (),
    varied: bool = False,
) -> ReleaseFolder:
    """Seal a synthetic release below ``root``, the folder of releases.

    A block has ``episodes`` for training, or a fifth of it for validation; last steps succeed with the probability
    ``success``. ``parent`` and ``reused`` are those of ``rema_data.release.seal.seal``. With ``varied``, every second
    episode has a variation.
    """
    staging = root / f".{name}.staging"
    counts = {"train": episodes, "val": max(1, episodes // 5)}
    keys = [BlockKey(number, task, split) for number in rounds for task in tasks for split in counts]
    for key in keys:
        make_block(staging / key.path, key, counts[key.split], seed, success, varied)
    about = Description(name, f"The release {name}", "Synthetic: for tests only.", "CC-BY-4.0", "The rema authors")
    return seal(staging, root, about, keys, fingerprint=FINGERPRINT, parent=parent, reused=reused)
