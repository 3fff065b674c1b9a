"""The observation cache: observations on disk, addressed by what they depend on, shared by all policies.

A file holds the observations of one block of situations. Its name is the hash of the situations and of the code and
parameters that observe them, so a file is never stale; its content carries a checksum, so a damaged one is rebuilt.
"""

from __future__ import annotations

import hashlib
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from rema_data import grid
from rema_data.bounded import npz_arrays, zstd_bytes
from rema_data.interrupts import check
from rema_data.schema import Observation, Situation
from rema_data.storage import write_atomic

__all__ = ["Block", "ObservationCache"]

FORMAT = "rema observation cache 3"
_EE = (2, grid.EE_PIXELS, grid.EE_PIXELS)
_SCENE = (grid.SCENE_PIXELS, grid.SCENE_PIXELS)
_ROWS: dict[str, tuple[str, tuple[int, ...]]] = {
    "scenes": ("uint16", _SCENE),
    "which": ("uint32", ()),
    "depths": ("uint16", _EE),
    "masks": ("uint8", (math.prod(_EE) // 8,)),
}
"""Type of every array, and shape of one of its rows."""
_SLACK = 1 << 16
_CHECKSUM, _SIZE = 32, 8
"""Bytes of the two fields before the arrays."""


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Observations of N situations with U different end effectors."""

    scenes: npt.NDArray[np.uint16]  # (N, 64, 64), 0.1 mm
    which: npt.NDArray[np.uint32]  # (N,), end-effector map of every observation
    depths: npt.NDArray[np.uint16]  # (U, 2, 112, 112), 0.1 mm
    masks: npt.NDArray[np.bool_]  # (U, 2, 112, 112)

    def __len__(self) -> int:
        """Number of observations N."""
        return len(self.scenes)

    def observation(self, position: int) -> Observation:
        """One observation, exactly as it was made."""
        effector = self.which[position]
        return Observation(self.scenes[position], self.depths[effector], self.masks[effector])


class ObservationCache:
    """Observations of situations, from disk if there; ``code`` identifies all that ``observe`` depends on."""

    def __init__(self, root: Path, observe: Callable[[Situation], Observation], code: str) -> None:
        self._root = root
        self._observe = observe
        self._code = code

    def _path(self, situations: Sequence[Situation]) -> Path:
        total = hashlib.sha256(f"{FORMAT}\n{self._code}\n".encode())
        for situation in situations:
            total.update(repr(situation).encode() + b"\n")  # repr of a float is exact
        digest = total.hexdigest()
        return self._root / digest[:2] / f"{digest}.obs"

    def ensure(self, situations: Sequence[Situation]) -> bool:
        """Make sure that a block is on disk and whole; whether it had to be made."""
        path = self._path(situations)
        if _payload(path) is not None:
            return False
        self._make(path, situations)
        return True

    def load(self, situations: Sequence[Situation]) -> Block:
        """The block of these situations, made again where the file is missing or damaged."""
        path = self._path(situations)
        found = _payload(path)
        try:
            return self._make(path, situations) if found is None else _decode(found, len(situations))
        except ValueError:  # whole, and of another form
            return self._make(path, situations)

    def _make(self, path: Path, situations: Sequence[Situation]) -> Block:
        scenes = np.empty((len(situations), *_SCENE), np.uint16)
        which = np.empty(len(situations), np.uint32)
        effectors: dict[bytes, int] = {}
        depths: list[npt.NDArray[np.uint16]] = []
        masks: list[npt.NDArray[np.bool_]] = []
        for n, situation in enumerate(situations):
            check()
            seen = self._observe(situation)
            scenes[n] = seen.scene
            if (
                n
                and np.array_equal(seen.depth, depths[which[n - 1]])
                and np.array_equal(seen.mask, masks[which[n - 1]])
            ):
                which[n] = which[n - 1]  # the same bare gripper all along: cheaper to compare than to hash
                continue
            key = hashlib.sha256(seen.depth.tobytes() + seen.mask.tobytes()).digest()
            if key not in effectors:
                effectors[key] = len(depths)
                depths.append(seen.depth)
                masks.append(seen.mask)
            which[n] = effectors[key]
        block = Block(scenes, which, np.stack(depths), np.stack(masks))
        write_atomic(path, _encode(block))
        return block


def _encode(block: Block) -> bytes:
    """Checksum, size of the arrays as an npz file, and that file compressed."""
    buffer = io.BytesIO()
    masks = np.packbits(block.masks.reshape(len(block.masks), -1), axis=1)
    np.savez(buffer, scenes=block.scenes, which=block.which, depths=block.depths, masks=masks)
    packed: bytes = pa.Codec("zstd", compression_level=1).compress(buffer.getbuffer(), asbytes=True)
    content = buffer.getbuffer().nbytes.to_bytes(_SIZE, "big") + packed
    return hashlib.sha256(content).digest() + content


def _payload(path: Path) -> bytes | None:
    """What follows the checksum of a file, or None where the file is missing or not what was written."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    content = data[_CHECKSUM:]
    return content if hashlib.sha256(content).digest() == data[:_CHECKSUM] else None


def _decode(content: bytes, count: int) -> Block:
    """Inverse of ``_encode`` for a block of ``count`` situations; a ValueError for anything else."""
    most = count * sum(np.dtype(dtype).itemsize * math.prod(row) for dtype, row in _ROWS.values()) + _SLACK
    raw = zstd_bytes(content[_SIZE:], int.from_bytes(content[:_SIZE], "big"), most)
    arrays = npz_arrays(raw, _ROWS, dict.fromkeys(_ROWS, count))
    scenes, which, depths, masks = (arrays[name] for name in _ROWS)
    if len(scenes) != count or len(which) != count or len(depths) != len(masks) or (which >= len(depths)).any():
        raise ValueError(f"it does not hold {count} observations")
    unpacked = np.unpackbits(masks, axis=1, count=math.prod(_EE)).astype(bool).reshape(len(depths), *_EE)
    return Block(scenes, which, depths, unpacked)
