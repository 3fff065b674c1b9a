"""Writes blocks of one task as a LeRobot dataset; see ``lerobot`` for the layout."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow as pa

from rema_data.convert import lerobot_stats as statistics
from rema_data.convert.folders import NewDataset
from rema_data.convert.layout import INSTRUCTIONS, obs_of_scenes, planes_of_end_effectors
from rema_data.convert.lerobot_features import (
    DATA_PATH,
    EPISODES_PATH,
    FPS,
    LABELS,
    MAPS,
    VERSION,
    features,
    frames,
    hugging_face,
)
from rema_data.convert.nested import nested, with_features, write_tables
from rema_data.convert.pieces import Piece
from rema_data.heights import unpack_mask
from rema_data.release.manifest import BlockEntry
from rema_data.storage import new_file, write_atomic
from rema_data.store.columns import EPISODE_COLUMNS, VARIATION, columns_at
from rema_data.store.keys import SPLITS

__all__ = ["write_dataset"]

Array = npt.NDArray[Any]
_EPISODE = ("round", "split", "episode", "seed", "success", "failure", "failed_step", VARIATION)
"""Columns of ``episodes.parquet`` that ``meta/episodes`` has too, where the release has them."""
_CHUNK_FILES = 1000
_FILE_MB, _VIDEO_MB = 100, 200
"""LeRobot's own defaults, for what is appended to the dataset."""


def write_dataset(dataset: NewDataset) -> None:
    """Write all files of a dataset; OSError where the disk refuses."""
    _Writer(dataset).write()


class _Writer:
    """Writes the frames and keeps what the files in ``meta`` need: a few hundred bytes a step."""

    def __init__(self, dataset: NewDataset) -> None:
        self._dataset = dataset
        self._columns: defaultdict[str, list[Array]] = defaultdict(list)
        self._episodes: list[pa.Table] = []
        self._files: list[int] = []  # of every episode
        self._scene, self._end_effector = statistics.PlaneCounts(1), statistics.PlaneCounts(4)
        self._frames = self._episode_count = 0

    def write(self) -> None:
        for number, block in enumerate(self._dataset.blocks):
            self._write_block(number, block)
        columns = {name: np.concatenate(arrays) for name, arrays in self._columns.items()}
        self._write_episodes(columns)
        self._write_tasks()
        maps = self._dataset.maps
        stats = {
            "observation.scene": self._scene.stats(maps, (), self._frames),
            "observation.end_effector": self._end_effector.stats(maps, (1, 3), self._frames),
            **statistics.of_columns(columns),
        }
        self._write_json("meta/stats.json", stats)
        self._write_json("meta/info.json", self._info())

    def _write_block(self, number: int, block: BlockEntry) -> None:
        path = self._dataset.folder / DATA_PATH.format(chunk_index=0, file_index=number)
        with new_file(path) as file:
            write_tables(file, self._tables(number, block), MAPS)

    def _tables(self, number: int, block: BlockEntry) -> Iterator[pa.Table]:
        for piece in self._dataset.pieces(block):
            yield self._table(piece)
            self._episodes.append(piece.episodes)
            self._files += [number] * piece.episodes.num_rows
            self._frames += piece.steps.num_rows
            self._episode_count += piece.episodes.num_rows

    def _table(self, piece: Piece) -> pa.Table:
        maps, chosen = piece.maps, self._dataset.maps
        scenes = np.moveaxis(obs_of_scenes(maps.scene, chosen), -1, 1)
        end_effectors = planes_of_end_effectors(maps.ee_depth, maps.ee_mask, chosen)
        self._scene.add(0, maps.scene)
        times = np.bincount(maps.ee_row, minlength=len(maps.ee_depth))
        masks = unpack_mask(maps.ee_mask)
        for state in (0, 1):
            self._end_effector.add(2 * state, maps.ee_depth[:, state], times)
            self._end_effector.add(2 * state + 1, masks[:, state].view(np.uint8), times)
        values = frames(piece.steps, self._frames, self._episode_count)
        for name, array in values.items():
            self._columns[name].append(array)
        columns = {
            "observation.scene": nested(scenes),
            "observation.end_effector": nested(end_effectors[maps.ee_row]),
            **{name: nested(array) for name, array in values.items()},
            **{name: piece.steps[name].fill_null("") for name in LABELS},
        }
        table = pa.table(columns)
        return table.cast(with_features(table.schema, hugging_face(chosen)))

    def _write_episodes(self, columns: dict[str, Array]) -> None:
        episodes = pa.concat_tables(self._episodes)
        lengths = episodes["steps"].to_numpy().astype(np.int64)
        ends = np.cumsum(lengths)
        zeros = pa.array(np.zeros(len(lengths), np.int64))
        task = INSTRUCTIONS[self._dataset.task]
        known = columns_at(EPISODE_COLUMNS, self._dataset.release.manifest.schema_version)
        table = pa.table(
            {
                "episode_index": np.arange(len(lengths)),
                "tasks": pa.array([[task]] * len(lengths)),
                "length": lengths,
                "dataset_from_index": ends - lengths,
                "dataset_to_index": ends,
                "data/chunk_index": zeros,
                "data/file_index": pa.array(self._files, pa.int64()),
                "meta/episodes/chunk_index": zeros,
                "meta/episodes/file_index": zeros,
                **{column.name: episodes[column.name] for column in known if column.name in _EPISODE},
                **{name: nested(array) for name, array in statistics.episode_stats(columns, lengths).items()},
            }
        )
        self._write_table(EPISODES_PATH.format(chunk_index=0, file_index=0), table)

    def _write_tasks(self) -> None:
        table = pd.DataFrame({"task_index": [0]}, index=pd.Index([INSTRUCTIONS[self._dataset.task]], name="task"))
        self._write_table("meta/tasks.parquet", pa.Table.from_pandas(table))

    def _write_table(self, name: str, table: pa.Table) -> None:
        with new_file(self._dataset.folder / name) as file:
            write_tables(file, [table])

    def _write_json(self, name: str, content: dict[str, Any]) -> None:
        write_atomic(self._dataset.folder / name, json.dumps(content, indent=4) + "\n")

    def _info(self) -> dict[str, Any]:
        splits, first = {}, 0
        for split in SPLITS:
            count = sum(block.episodes for block in self._dataset.blocks if block.split == split)
            if count:
                splits[split] = f"{first}:{first + count}"
            first += count
        return {
            "codebase_version": VERSION,
            "robot_type": "dual_kuka_iiwa_wsg50",
            "total_episodes": self._episode_count,
            "total_frames": self._frames,
            "total_tasks": 1,
            "chunks_size": _CHUNK_FILES,
            "data_files_size_in_mb": _FILE_MB,
            "video_files_size_in_mb": _VIDEO_MB,
            "fps": FPS,
            "splits": splits,
            "data_path": DATA_PATH,
            "video_path": None,
            "features": features(self._dataset.maps),
        }
