"""Parquet that ``datasets.load_dataset`` opens: the release as one dataset, a configuration a task, a row a step.

::

    rema-mini/
        README.md                           the card: which files are which configuration and split
        grasp_push/train-round-1.parquet    the columns of steps.parquet, the seed, and the maps
        rema/                               what ``rema import`` needs (``seal``)
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from rema_data.convert.base import Maps
from rema_data.convert.folders import FolderFormat, NewDataset
from rema_data.convert.layout import INSTRUCTIONS, obs_dtype, obs_of_scenes, planes_of_end_effectors
from rema_data.convert.nested import array_feature, feature, nested, read_nested, with_features, write_tables
from rema_data.convert.pieces import Piece
from rema_data.convert.seal import SealedFolder
from rema_data.grid import EE_PIXELS, SCENE_PIXELS
from rema_data.release.licences import hub_licence
from rema_data.release.manifest import BlockEntry, Manifest
from rema_data.storage import new_file, write_atomic
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS, VARIATION, Column, columns_at
from rema_data.store.keys import SPLITS, BlockKey

__all__ = ["HuggingFace", "column_lines", "config_lines", "steps_path", "write_steps"]

Array = npt.NDArray[Any]

_MAPS = {"scene": (SCENE_PIXELS, SCENE_PIXELS), "end_effector": (4, EE_PIXELS, EE_PIXELS)}
_MEANING = {
    "scene": "height above the table before the step",
    "end_effector": "height and mask of the acting hand at the start, height and mask at the end, at yaw 0",
}
_OF_EPISODES = ("seed", VARIATION)
"""Columns of ``episodes.parquet`` that every step of the episode has too."""


def _columns(version: int) -> tuple[list[Column], list[Column]]:
    """Columns of the episodes and of the steps in an export: all but the places of the maps in the release."""
    of_episodes = [column for column in columns_at(EPISODE_COLUMNS, version) if column.name in _OF_EPISODES]
    of_steps = [column for column in columns_at(STEP_COLUMNS, version) if column.name not in ("scene_row", "ee_row")]
    return of_episodes, of_steps


def steps_path(key: BlockKey) -> str:
    """Where the steps of a block lie in the folder of the dataset."""
    return f"{key.task}/{key.split}-round-{key.round}.parquet"


class HuggingFace(FolderFormat):
    """A folder for Hugging Face ``datasets``."""

    name: ClassVar[str] = "hf"

    def folder(self, manifest: Manifest, task: str) -> str:
        """All tasks are in the folder of the release."""
        return manifest.name

    def write(self, dataset: NewDataset) -> None:
        """See ``FolderFormat``."""
        for block in dataset.blocks:
            with new_file(dataset.folder / steps_path(block.key)) as file:
                write_steps(file, dataset.pieces(block), dataset.maps, dataset.release.manifest.schema_version)
        write_atomic(dataset.folder / "README.md", _card(dataset))

    def observations(self, dataset: SealedFolder, number: int, steps: int) -> Iterator[tuple[Array, Array]]:
        """See ``FolderFormat``."""
        for columns in read_nested(dataset.path / steps_path(dataset.blocks[number]), _MAPS, steps):
            yield columns["scene"][..., None], np.moveaxis(columns["end_effector"], 1, -1)


def write_steps(file: Any, pieces: Iterable[Piece], maps: Maps, version: int) -> None:
    """Write pieces of a block to a file, a row a step, with the columns of a schema version: that of the release."""
    write_tables(file, (_table(piece, maps, version) for piece in pieces), _MAPS)


def _table(piece: Piece, chosen: Maps, version: int) -> pa.Table:
    maps = piece.maps
    end_effectors = planes_of_end_effectors(maps.ee_depth, maps.ee_mask, chosen)
    of_episodes, of_steps = _columns(version)
    rows = np.repeat(np.arange(len(piece.episodes)), piece.episodes["steps"].to_numpy())
    columns = {
        "scene": nested(obs_of_scenes(maps.scene, chosen)[..., 0]),
        "end_effector": nested(end_effectors[maps.ee_row]),
        **{column.name: piece.episodes[column.name].take(rows) for column in of_episodes},
        **{column.name: piece.steps[column.name] for column in of_steps},
    }
    features = {name: array_feature(shape, obs_dtype(chosen)) for name, shape in _MAPS.items()}
    features |= {column.name: feature(column.type) for column in (*of_episodes, *of_steps)}
    table = pa.table(columns)
    return table.cast(with_features(table.schema, features))


def config_lines(blocks: Sequence[BlockEntry], within: str = "") -> list[str]:
    """Front matter of a card: a configuration a task, of the files of these blocks below the folder ``within``."""
    lines = ["configs:"]
    for task in dict.fromkeys(block.task for block in blocks):
        lines += [f"- config_name: {task}", "  data_files:"]
        here = {block.split for block in blocks if block.task == task}
        for split in (split for split in SPLITS if split in here):
            lines += [f"  - split: {split}", f"    path: {within}{task}/{split}-round-*.parquet"]
    return lines


def column_lines(tasks: Iterable[str], maps: Maps, version: int) -> list[str]:
    """Body of a card: what the configurations and the columns of a schema version are."""
    of_episodes, of_steps = _columns(version)
    unit = "m" if maps == "metres" else "0.1 mm, from -10 mm"
    shown = [Column(name, obs_dtype(maps), meaning, unit) for name, meaning in _MEANING.items()]
    return [
        "| configuration | task |",
        "|---|---|",
        *(f"| `{task}` | {INSTRUCTIONS[task]} |" for task in tasks),
        "",
        "| column | type | unit | frame | meaning |",
        "|---|---|---|---|---|",
        *(f"| `{c.name}` | {c.type} | {c.unit} | {c.frame} | {c.meaning} |" for c in (*shown, *of_episodes, *of_steps)),
    ]


def _card(dataset: NewDataset) -> str:
    """The card. JSON strings are valid YAML."""
    manifest = dataset.release.manifest
    tasks = list(dict.fromkeys(block.task for block in dataset.blocks))
    lines = [
        "---",
        f"pretty_name: {json.dumps(manifest.title)}",
        f"license: {hub_licence(manifest.license)}",
        "task_categories:",
        "- robotics",
        *config_lines(dataset.blocks),
        "---",
        "",
        f"# {manifest.title}",
        "",
        manifest.description,
        "",
        f"Exported from the release {manifest.name} ({manifest.sha256}); `rema import` brings it back.",
        "",
        "```python",
        "import datasets",
        "",
        f'steps = datasets.load_dataset("{manifest.name}", "{tasks[0]}", split="{dataset.blocks[0].split}")',
        "```",
        "",
        *column_lines(tasks, dataset.maps, manifest.schema_version),
        "",
        f"Please cite: {manifest.citation}",
        "",
    ]
    return "\n".join(lines)
