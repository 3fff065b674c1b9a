"""The observation cache: observations on disk, addressed by what they depend on, shared by all policies.

A file holds the observations of one block of situations. Its name is the hash of the situations and of the code and
parameters that observe them, so a file is never stale; its content carries a checksum, so a damaged one is rebuilt.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from rema_data import grid
from rema_data.schema import Observation, Situation
from rema_data.storage import write_atomic

__all__ = ["Block", "ObservationCache"]

FORMAT = "rema observation bank 2"
_EE = (2, grid.EE_PIXELS, grid.EE_PIXELS)
_SCENE = (grid.SCENE_PIXELS, grid.SCENE_PIXELS)


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Observations of N situations with U different end effectors.

    Attributes
    ----------
    scenes : uint16 (N, 64, 64)
        0.1 mm.
    which : uint32 (N,)
        End-effector map of every observation.
    depths : uint16 (U, 2, 112, 112)
        0.1 mm.
    masks : bool (U, 2, 112, 112)
    """

    scenes: npt.NDArray[np.uint16]
    which: npt.NDArray[np.uint32]
    depths: npt.NDArray[np.uint16]
    masks: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        """Number of observations N."""
        return len(self.scenes)

    def observation(self, position: int) -> Observation:
        """One observation, exactly as it was made."""
        effector = self.which[position]
        return Observation(self.scenes[position], self.depths[effector], self.masks[effector])


class ObservationCache:
    """Observations of situations, from disk where they are there already.

    Parameters
    ----------
    root : Path
    observe : callable
        Situation to Observation.
    code : str
        Identity of everything that ``observe`` depends on.
    """

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
        """Make sure that a block is on disk and whole; whether it had to be made.

        Raises
        ------
        StorageError
            The disk is full or may not be written.
        """
        path = self._path(situations)
        if _payload(path) is not None:
            return False
        self._make(path, situations)
        return True

    def load(self, situations: Sequence[Situation]) -> Block:
        """The block of these situations, made again where the file is missing or damaged."""
        path = self._path(situations)
        found = _payload(path)
        return self._make(path, situations) if found is None else _decode(*found)

    def _make(self, path: Path, situations: Sequence[Situation]) -> Block:
        scenes = np.empty((len(situations), *_SCENE), np.uint16)
        which = np.empty(len(situations), np.uint32)
        effectors: dict[bytes, int] = {}
        depths: list[npt.NDArray[np.uint16]] = []
        masks: list[npt.NDArray[np.bool_]] = []
        for n, situation in enumerate(situations):
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
    """One line of JSON (sizes, checksum), then the compressed arrays."""
    masks = np.packbits(block.masks.reshape(len(block.masks), -1), axis=1)
    raw = b"".join(np.ascontiguousarray(a).tobytes() for a in (block.scenes, block.which, block.depths, masks))
    packed: bytes = pa.Codec("zstd", compression_level=1).compress(raw, asbytes=True)
    sizes = {"observations": len(block.scenes), "effectors": len(block.depths), "bytes": len(raw)}
    header = {"format": FORMAT, **sizes, "sha256": _checksum(sizes, packed)}
    return json.dumps(header).encode() + b"\n" + packed


def _checksum(sizes: dict[str, int], packed: bytes) -> str:
    return hashlib.sha256(json.dumps(sizes, sort_keys=True).encode() + b"\n" + packed).hexdigest()


def _payload(path: Path) -> tuple[dict[str, Any], bytes] | None:
    """Header and compressed arrays of a file, or None where it is missing or not what was written."""
    try:
        head, _, packed = path.read_bytes().partition(b"\n")
        header = json.loads(head)
        sizes = {name: header[name] for name in ("observations", "effectors", "bytes")}
        if header["format"] == FORMAT and header["sha256"] == _checksum(sizes, packed):
            return header, packed
    except (OSError, ValueError, KeyError, TypeError):
        pass
    return None


def _decode(header: dict[str, Any], packed: bytes) -> Block:
    raw = pa.Codec("zstd").decompress(packed, header["bytes"], asbytes=True)
    n, u = header["observations"], header["effectors"]
    pixels = int(np.prod(_EE))
    offset = 0

    def take(dtype: type[np.generic], *shape: int) -> npt.NDArray[np.generic]:
        nonlocal offset
        part = np.frombuffer(raw, dtype, int(np.prod(shape)), offset).reshape(shape)
        offset += part.nbytes
        return part

    scenes, which = take(np.uint16, n, *_SCENE), take(np.uint32, n)
    depths, masks = take(np.uint16, u, *_EE), take(np.uint8, u, (pixels + 7) // 8)
    unpacked = np.unpackbits(masks, axis=1, count=pixels).astype(bool).reshape(u, *_EE)  # type: ignore[arg-type]
    return Block(scenes, which, depths, unpacked)  # type: ignore[arg-type]
