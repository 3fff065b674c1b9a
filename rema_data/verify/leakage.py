"""Scenes that must not occur twice: in training and validation, or in a frozen scenario list."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from rema_data.bounded import parquet_table
from rema_data.errors import IntegrityError, MissingFileError
from rema_data.manifests import manifests_dir
from rema_data.repair import restore
from rema_data.schema import Shape
from rema_data.verify.findings import rows_of

__all__ = ["Scenes", "frozen_lists", "frozen_scenes", "read_frozen", "scene_keys"]

_COLUMNS = ("length_m", "width_m", "arm_m", "height_m", "x_m", "y_m", "yaw_rad")
_SHAPES = tuple(item.value for item in Shape)
Keys = Sequence[bytes]


def scene_keys(table: pa.Table, prefix: str) -> Keys:
    """Object and pose in the columns ``{prefix}_...`` of every row, as bytes that are equal where all numbers are."""
    numbers = np.empty((table.num_rows, 1 + len(_COLUMNS)))
    shape = pc.index_in(table[f"{prefix}_shape"], value_set=pa.array(_SHAPES))
    numbers[:, 0] = pc.fill_null(shape, -1).to_numpy()
    for column, name in enumerate(_COLUMNS, 1):
        numbers[:, column] = table[f"{prefix}_{name}"].to_numpy() + 0.0  # -0.0 and 0.0 are one place
    keys: list[bytes] = numbers.view(f"V{numbers.strides[0]}")[:, 0].tolist()
    return keys


@dataclass
class Scenes:
    """Scenes of the blocks of a release, gathered one block after the other."""

    blocks: dict[str, tuple[str, Keys]] = field(default_factory=dict)

    def add(self, file: str, split: str, steps: pa.Table) -> None:
        """Remember the scenes of the table in ``file``."""
        self.blocks[file] = (split, scene_keys(steps, "target"))

    def check(self, frozen: Mapping[bytes, str], report: Callable[[str, str, str], None]) -> None:
        """Look for scenes of the training split in the validation split, and for frozen scenarios in both.

        ``frozen`` has the name of every frozen scenario by its key; ``report`` takes file, place in it, and detail.
        """
        trained: dict[bytes, tuple[str, int]] = {}
        for file, (split, keys) in self.blocks.items():
            if split == "train":
                trained.update((key, (file, row)) for row, key in enumerate(keys))
        for file, (split, keys) in self.blocks.items():
            if split == "val":
                bad = _members(keys, trained)
                if bad.any():
                    other, row = trained[keys[int(np.argmax(bad))]]
                    report(file, rows_of(bad), f"the scene occurs in the training split too: {other}, row {row}")
            bad = _members(keys, frozen)
            if bad.any():
                name = frozen[keys[int(np.argmax(bad))]]
                report(file, rows_of(bad), f"the scene occurs in a frozen scenario list: {name}")


def _members(keys: Keys, known: Mapping[bytes, object]) -> npt.NDArray[Any]:
    return np.fromiter((key in known for key in keys), bool, len(keys))


def frozen_lists(folder: Path) -> list[Path]:
    """The frozen lists below a manifests folder: ``scenarios/VERSION/TASK_test.parquet`` and ``TASK_val.parquet``."""
    return [
        path for path in sorted((folder / "scenarios").glob("*/*.parquet")) if path.stem.endswith(("_test", "_val"))
    ]


def frozen_scenes() -> dict[bytes, str]:
    """Scenes of all frozen lists with their names, as ``read_frozen``; MissingFileError without lists."""
    frozen: dict[bytes, str] = {}
    for path in frozen_lists(manifests_dir()):
        frozen.update(read_frozen(path))
    if not frozen:
        raise MissingFileError(
            f"there are no scenario lists in {manifests_dir()} to check this data against",
            hint=restore(manifests_dir()),
            path=str(manifests_dir()),
        )
    return frozen


def read_frozen(path: Path) -> dict[bytes, str]:
    """Scenes of all steps of a frozen list, each with its name: ``VERSION/TASK/SPLIT/INDEX``. Or IntegrityError."""
    try:
        return _read(path, path.stat().st_mtime_ns)
    except (pa.ArrowException, ValueError, KeyError, OSError) as error:
        raise IntegrityError(f"{path} cannot be read: {error}", hint=restore(path), path=str(path)) from error


@lru_cache(maxsize=32)
def _read(path: Path, _changed_ns: int) -> dict[bytes, str]:
    table = parquet_table(path)
    task, _, split = path.stem.rpartition("_")
    names = [f"{path.parent.name}/{task}/{split}/{index:05d}" for index in table["index"].to_pylist()]
    found: dict[bytes, str] = {}
    for name in table.schema.names:
        prefix, _, what = name.rpartition("_")
        if what == "shape" and prefix.startswith("object"):
            found.update(zip(scene_keys(table, prefix), names, strict=True))
    return found
