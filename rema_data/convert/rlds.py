"""RLDS: episodes of steps in the layout of TensorFlow Datasets, which reads it without a builder of ours.

::

    grasp_push/
        dataset_info.json
        features.json
        rema_grasp_push-train.tfrecord-00000-of-00003     the episodes of a block, a file (shard) a block
        rema/                                             what ``rema import`` needs (``seal``)

Maps are compressed by themselves, as ``tfds.features.Tensor`` with ``encoding="zlib"`` does it.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from rema_data.convert.folders import FolderFormat, NewDataset
from rema_data.convert.layout import INSTRUCTIONS, obs_dtype, obs_of_end_effectors, obs_of_scenes, trajectory
from rema_data.convert.pieces import PIECE_STEPS, Piece
from rema_data.convert.rlds_features import EPISODE_VALUES, MAPS, VERSION, episode_texts, features
from rema_data.convert.seal import SealedFolder, damaged
from rema_data.convert.tfrecord import Values, byte_lists, example, read_records, write_record
from rema_data.schema import TASKS
from rema_data.storage import new_file, not_written, write_atomic
from rema_data.store.keys import SPLITS, BlockKey

__all__ = ["Rlds"]

Array = npt.NDArray[Any]

_LEVEL = 6
_MOST_STEP_BYTES = 1 << 20
_TEXTS = ("primitive", "embodiment", "policy", "failure")


def _name(task: str) -> str:
    return f"rema_{task}"


def _shard(blocks: Sequence[BlockKey], key: BlockKey) -> str:
    """Name of the file of a block among the blocks of a task."""
    split = [block for block in blocks if block.split == key.split]
    return f"{_name(key.task)}-{key.split}.tfrecord-{split.index(key):05d}-of-{len(split):05d}"


class Rlds(FolderFormat):
    """The layout of TensorFlow Datasets."""

    name: ClassVar[str] = "rlds"

    def write(self, dataset: NewDataset) -> None:
        """See ``FolderFormat``."""
        sizes: dict[BlockKey, int] = {}
        keys = [block.key for block in dataset.blocks]
        for block in dataset.blocks:
            path, written, found = dataset.folder / _shard(keys, block.key), hashlib.sha256(), hashlib.sha256()
            with new_file(path) as file:
                sizes[block.key] = longest = 0
                for piece in dataset.pieces(block):
                    for record in _records(piece, dataset):
                        write_record(file, record)
                        written.update(record)
                        sizes[block.key] += len(record)
                        longest = max(longest, len(record))
                file.seek(0)
                try:
                    for record in read_records(file, longest):
                        found.update(record)
                except ValueError as error:
                    raise not_written(path, str(error)) from error
                if found.digest() != written.digest():
                    raise not_written(path)
        write_atomic(dataset.folder / "dataset_info.json", json.dumps(_info(dataset, sizes), indent=2) + "\n")
        about = json.dumps(features(dataset.maps, dataset.release.manifest.schema_version), indent=2)
        write_atomic(dataset.folder / "features.json", about + "\n")

    def observations(self, dataset: SealedFolder, number: int, steps: int) -> Iterator[tuple[Array, Array]]:
        """See ``FolderFormat``."""
        key = dataset.blocks[number]
        path = dataset.path / _shard(dataset.blocks, key)
        forms = {f"steps/observation/{name}": shape for name, shape in MAPS.items()}
        dtype, most = np.dtype(obs_dtype(dataset.header.maps)), len(TASKS[key.task])
        waiting: list[list[Array]] = []
        unpacked: dict[tuple[str, bytes], Array] = {}  # of those that wait: steps share maps
        try:
            with path.open("rb") as file:
                for record in read_records(file, most * _MOST_STEP_BYTES):
                    lists = byte_lists(record, list(forms))
                    if len({len(found) for found in lists.values()}) != 1 or len(next(iter(lists.values()))) > most:
                        raise ValueError(f"an episode has other maps than steps, or more than {most} steps")
                    for name, shape in forms.items():
                        for data in lists[name]:
                            if (name, data) not in unpacked:
                                unpacked[name, data] = _unpacked(data, shape, dtype)
                    columns = [[unpacked[name, data] for data in lists[name]] for name in forms]
                    waiting += [list(step) for step in zip(*columns, strict=True)]
                    if len(waiting) >= PIECE_STEPS:
                        yield _stacked(waiting)
                        waiting, unpacked = [], {}
        except (OSError, ValueError, zlib.error) as error:
            raise damaged(path, str(error)) from error
        if waiting:
            yield _stacked(waiting)


def _unpacked(data: bytes, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
    size = int(np.prod(shape)) * dtype.itemsize
    plain = zlib.decompressobj().decompress(data, size + 1)
    if len(plain) != size:
        raise ValueError(f"a map is not {dtype} {shape}")
    return np.frombuffer(plain, dtype).reshape(shape)


def _stacked(steps: list[list[Array]]) -> tuple[Array, Array]:
    scenes, end_effectors = (np.stack(arrays) for arrays in zip(*steps, strict=True))
    return scenes, end_effectors


def _records(piece: Piece, dataset: NewDataset) -> Iterator[bytes]:
    """An example an episode."""
    maps, about = piece.maps, trajectory(piece.steps)
    names = episode_texts(dataset.release.manifest.schema_version)
    instruction = INSTRUCTIONS[dataset.task].encode()
    scenes = [zlib.compress(scene, _LEVEL) for scene in obs_of_scenes(maps.scene, dataset.maps)]
    hands = [zlib.compress(hand, _LEVEL) for hand in obs_of_end_effectors(maps.ee_depth, maps.ee_mask, dataset.maps)]
    texts = {name: [_text(text) for text in piece.steps[name].to_pylist()] for name in _TEXTS}
    for row in piece.episodes.to_pylist():
        count = row["steps"]
        at = slice(row["first_step"], row["first_step"] + count)
        position = np.arange(count)
        found: dict[str, Values] = {
            "steps/observation/scene": scenes[at],
            "steps/observation/end_effector": [hands[n] for n in maps.ee_row[at]],
            "steps/action": about["actions"][at].reshape(-1),
            "steps/grid_index": about["grid_index"][at],
            "steps/reward": about["rewards"][at],
            "steps/discount": 1 - about["dones"][at].astype(np.float32),
            "steps/is_first": (position == 0).astype(np.int64),
            "steps/is_last": (position == count - 1).astype(np.int64),
            "steps/is_terminal": about["dones"][at],
            "steps/language_instruction": [instruction] * count,
            **{f"steps/{name}": texts[name][at] for name in _TEXTS},
            **{f"episode_metadata/{name}": [_text(row[name])] for name in names},
        }
        for name in EPISODE_VALUES:
            value = row[name]
            found[f"episode_metadata/{name}"] = np.array([-1 if value is None else value], np.int64)
        yield example(found)


def _text(value: object) -> bytes:
    """A value of a row as text: null is empty, a root seed of 0 is not."""
    return b"" if value is None else str(value).encode()


def _info(dataset: NewDataset, sizes: dict[BlockKey, int]) -> dict[str, Any]:
    manifest = dataset.release.manifest
    splits = []
    for split in SPLITS:
        blocks = [block for block in dataset.blocks if block.split == split]
        if blocks:
            splits.append(
                {
                    "name": split,
                    "shardLengths": [str(block.episodes) for block in blocks],
                    "numBytes": str(sum(sizes[block.key] for block in blocks)),
                    "filepathTemplate": "{DATASET}-{SPLIT}.{FILEFORMAT}-{SHARD_X_OF_Y}",
                }
            )
    return {
        "name": _name(dataset.task),
        "version": VERSION,
        "description": f"{INSTRUCTIONS[dataset.task]} From {manifest.name}: {manifest.title}. {manifest.description}",
        "citation": manifest.citation,
        "redistributionInfo": {"license": manifest.license},
        "fileFormat": "tfrecord",
        "splits": splits,
    }
