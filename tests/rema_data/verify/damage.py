"""Synthetic releases for the tests of `rema verify`, and ways to damage them."""

from __future__ import annotations

import dataclasses
import io
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST, BlockEntry
from rema_data.schema import TASKS
from rema_data.store.block import BlockKey
from rema_data.store.tables import to_parquet
from rema_data.testing import make_release

GRASP_TRAIN = BlockKey(1, "grasp", "train")


def make_whole(root: Path, **options: Any) -> ReleaseFolder:
    """A release in which everything holds, of all tasks by default."""
    return make_release(root, **{"tasks": tuple(TASKS), "episodes": 15, **options})


def copy(release: ReleaseFolder, root: Path) -> ReleaseFolder:
    """A copy that may be written to, in the folder of releases ``root``."""
    target = root / release.manifest.name
    shutil.copytree(release.path, target)
    for path in target.rglob("*"):
        path.chmod(0o755 if path.is_dir() else 0o644)
    return ReleaseFolder(release.manifest, root)


def write_manifests(folder: Path) -> Path:
    """A manifests folder without a published release."""
    (folder / "datasets").mkdir(parents=True)
    (folder / "datasets" / "index.json").write_text(json.dumps({"releases": []}))
    return folder


def location(release: ReleaseFolder, key: BlockKey, file: str) -> str:
    return f"{release.manifest.name}/{key.path}/{file}"


def flip(path: Path, offset: int, bit: int = 0) -> None:
    """Turn one bit of a file around."""
    data = bytearray(path.read_bytes())
    data[offset] ^= 1 << bit
    path.write_bytes(data)


def reseal(
    release: ReleaseFolder,
    changes: Mapping[str, bytes | None],
    blocks: Callable[[BlockEntry], BlockEntry] = lambda block: block,
) -> ReleaseFolder:
    """Write other bytes (None: no file) at some locations, with a manifest that says they belong there."""
    entries = {file.location: file for file in release.manifest.files}
    for place, data in changes.items():
        path = release.root / place
        if data is None:
            path.unlink()
            del entries[place]
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
            entries[place] = dataclasses.replace(entries[place], bytes=len(data), sha256=sha256(data).hexdigest())
    manifest = dataclasses.replace(
        release.manifest, files=tuple(entries.values()), blocks=tuple(map(blocks, release.manifest.blocks))
    )
    (release.path / MANIFEST).write_bytes(manifest.to_bytes())
    return ReleaseFolder(manifest, release.root)


def with_values(table: pa.Table, name: str, values: Sequence[Any]) -> pa.Table:
    """The table with other values in a column."""
    position = table.schema.get_field_index(name)
    field = table.schema.field(position)
    return table.set_column(position, field, pa.array(values, field.type))


def with_value(table: pa.Table, name: str, row: int, value: Any) -> pa.Table:
    """The table with another value in one cell."""
    values = table[name].to_pylist()
    values[row] = value
    return with_values(table, name, values)


def change_cell(release: ReleaseFolder, key: BlockKey, file: str, name: str, row: int, value: Any) -> ReleaseFolder:
    """The release sealed with another value in one cell of a table."""
    place = location(release, key, file)
    table = pq.read_table(release.root / place)
    return reseal(release, {place: to_parquet(with_value(table, name, row, value))})


def parquet(table: pa.Table) -> bytes:
    """Any table as Parquet, with the writer's defaults."""
    buffer = io.BytesIO()
    pq.write_table(table, buffer)
    return buffer.getvalue()
