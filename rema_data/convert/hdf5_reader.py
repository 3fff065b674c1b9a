"""Reads the files of an HDF5 export; see ``hdf5`` for the layout, and for what decides what is imported."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
import pyarrow as pa

from rema_data.convert.base import ImportedBlock, Maps
from rema_data.convert.hdf5_file import FORMAT, VERSION, damaged, open_file, reading
from rema_data.convert.hdf5_parts import attributes, dataset, has, members, part, values
from rema_data.convert.hdf5_probe import survives
from rema_data.convert.layout import from_array, obs_dtype, stored_end_effectors, stored_scenes, trajectory
from rema_data.convert.pieces import PIECE_STEPS, Piece
from rema_data.errors import InputError, MissingFileError
from rema_data.grid import EE_PIXELS, SCENE_PIXELS
from rema_data.interrupts import check
from rema_data.progress import Progress
from rema_data.release.manifest import Manifest, parse_manifest
from rema_data.repair import upgrade
from rema_data.schema import TASKS
from rema_data.store.block import BlockKey, EncodedMaps
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS, arrow_schema, check_version, columns_at
from rema_data.store.tables import complete, episodes_table

__all__ = ["SUFFIXES", "expand", "open_source"]

SUFFIXES = (".hdf5", ".h5")
_DEMO = re.compile(r"demo_(\d+)")
_OBS = {"scene": (SCENE_PIXELS, SCENE_PIXELS, 1), "end_effector": (EE_PIXELS, EE_PIXELS, 4)}
_ROUNDING = 1e-6
_NAMED = 3
"""How many demos a note names."""

Array = npt.NDArray[Any]
Row = dict[str, Any]


def expand(sources: Sequence[Path]) -> list[Path]:
    """The files among some files and folders; raises MissingFileError where there are none."""
    if not sources:
        raise MissingFileError("no file to import was named", hint="name the folder that `rema export` wrote")
    paths: list[Path] = []
    for source in sources:
        found = [path for path in sorted(source.iterdir()) if path.suffix in SUFFIXES] if source.is_dir() else [source]
        if not found:
            raise MissingFileError(
                f"{source} was not written by `rema export`: it has no HDF5 file, and no rema/export.json",
                hint="name the folder that `rema export` wrote; only exports of releases can be imported",
                path=str(source),
            )
        paths += found
    return paths


@contextmanager
def open_source(paths: Sequence[Path], progress: Progress) -> Iterator[Hdf5Source]:
    """Open all files of an export."""
    with ExitStack() as stack:
        files = []
        progress.phase("look through", len(paths))
        for path in paths:
            if path.is_file() and not survives(path):
                raise damaged(path, "the HDF5 library does not come to an end with it")
            progress.advance(1)
        for path in paths:
            root = stack.enter_context(open_file(path))
            with reading(path):
                files.append(_File(path, root, progress))
        yield Hdf5Source(files)


class Hdf5Source:
    """The files of one export, open."""

    def __init__(self, files: Sequence[_File]) -> None:
        first, *others = files
        for file in others:
            if file.manifest.sha256 != first.manifest.sha256:
                one, other = (f"{manifest.name} {manifest.sha256[:12]}" for manifest in (first.manifest, file.manifest))
                raise InputError(
                    f"{first.path} belongs to the release {one}, {file.path} to {other}",
                    hint="import one release at a time",
                )
        owners: dict[BlockKey, Path] = {}
        for file in files:
            for key in file.demos:
                if key in owners:
                    raise InputError(
                        f"{owners[key]} and {file.path} both hold {key.path}",
                        hint="name one of the files",
                        key=key.path,
                    )
                owners[key] = file.path
        self._files = files
        self.manifest: Manifest = first.manifest
        self.card: dict[str, bytes] = first.card
        self.steps = sum(row["steps"] for file in files for demos in file.demos.values() for _, row in demos)

    def blocks(self) -> Iterator[ImportedBlock]:
        """See ``Source``."""
        for file in self._files:
            for key in file.demos:
                yield ImportedBlock(key, file.pieces(key))

    def notes(self) -> list[str]:
        """See ``Source``."""
        return [note for file in self._files for note in file.notes()]


class _File:
    """One file of an export: its header, and which demos belong to which block."""

    def __init__(self, path: Path, root: h5py.File, progress: Progress) -> None:
        self.path = path
        self._root = root
        self._changed: defaultdict[str, list[str]] = defaultdict(list)
        header = self._header()
        self._maps: Maps = header["maps"]
        self._version: int = header["schema_version"]
        self.manifest = parse_manifest(values(root, "rema/manifest").tobytes(), f"inside {path}")
        card = members(part(root, "rema/card")) if has(root, "rema/card") else ()
        self.card = {str(file.attrs["path"]): values(file.parent, name).tobytes() for name, file in card}
        self._versions: dict[BlockKey, int] = {}
        self.demos = self._index(progress)

    def _header(self) -> Row:
        header = attributes(part(self._root, "rema")) if has(self._root, "rema") else {}
        if header.get("format") != FORMAT:
            raise InputError(
                f"{self.path} was not written by `rema export`",
                hint="only exports of releases can be imported; collect new episodes with `rema collect`",
                path=str(self.path),
            )
        if header.get("format_version") != VERSION:
            raise InputError(
                f"{self.path} has format version {header.get('format_version')}, this rema reads {VERSION}",
                hint=upgrade(),
                path=str(self.path),
            )
        check_version(header.get("schema_version"), str(self.path))
        if header.get("maps") not in ("metres", "quantised"):
            raise damaged(self.path, f"its maps are {header.get('maps')}, which is not known")
        return header

    def _index(self, progress: Progress) -> dict[BlockKey, list[tuple[str, Row]]]:
        """Demos of every block with their columns, in the order of the episodes."""
        found: dict[BlockKey, list[tuple[str, Row]]] = {}
        data = part(self._root, "data")
        progress.phase(f"index {self.path.name}", len(data))
        for name, demo in members(data):
            check()
            progress.advance(1)
            if not _DEMO.fullmatch(name) or "episode" not in demo.attrs:
                self._changed["not an episode of the release"].append(name)
                continue
            row = self._episode(name, demo)
            key = BlockKey(row["round"], row["task"], row["split"])
            if key not in self._versions and not has(self._root, f"rema/{key.path}"):
                raise self._contradiction(name, f"says that it belongs to {key.path}, which is not in the file")
            version = self._version_of(key)
            row.update((item.name, item.default) for item in EPISODE_COLUMNS if item.since > version)
            found.setdefault(key, []).append((name, row))
        for demos in found.values():
            demos.sort(key=lambda item: item[1]["episode"])
            for (one, row), (other, following) in pairwise(demos):
                if row["episode"] == following["episode"]:
                    raise self._contradiction(other, f"is the same episode as {one}")
        return dict(sorted(found.items()))

    def _episode(self, name: str, demo: h5py.Group) -> Row:
        """Columns of an episode from the attributes of its demo."""
        given = attributes(demo)
        row: Row = {}
        for column in EPISODE_COLUMNS:
            value = given.get(column.name)
            if value is None:
                if not column.nullable and column.since == 1:
                    raise self._contradiction(name, f"has no attribute {column.name}")
            elif column.type == "string":
                if not isinstance(value, str):
                    raise self._contradiction(name, f"has the {column.name} {value!r}")
            elif getattr(value, "dtype", None) != column.type or value.shape:
                raise self._contradiction(name, f"has the {column.name} {value!r}, which is not {column.type}")
            else:
                value = value.item()
            row[column.name] = value
        if row["task"] not in TASKS:
            raise self._contradiction(name, f"is of the unknown task {row['task']!r}")
        if not 1 <= row["steps"] <= len(TASKS[row["task"]]) or given.get("num_samples") != row["steps"]:
            raise self._contradiction(name, f"has {given.get('num_samples')} samples, and {row['steps']} steps")
        return row

    def _version_of(self, key: BlockKey) -> int:
        """Schema version of a block: that of the release, unless it comes from an earlier one."""
        if key not in self._versions:
            version = attributes(part(self._root, f"rema/{key.path}")).get("schema_version", self._version)
            self._versions[key] = check_version(version, f"{self.path}, {key.path}")
        return self._versions[key]

    def _contradiction(self, name: str, why: str) -> Exception:
        return damaged(self.path, f"data/{name} {why}")

    def pieces(self, key: BlockKey) -> Iterator[Piece]:
        """Pieces of a block."""
        with reading(self.path):
            columns = _Columns(part(self._root, f"rema/{key.path}"), self._version_of(key))
        waiting: list[tuple[str, Row]] = []
        steps = 0
        for item in self.demos[key]:
            if waiting and steps + item[1]["steps"] > PIECE_STEPS:
                yield self._piece(waiting, columns)
                waiting, steps = [], 0
            waiting.append(item)
            steps += item[1]["steps"]
        yield self._piece(waiting, columns)

    def _piece(self, demos: Sequence[tuple[str, Row]], columns: _Columns) -> Piece:
        rows, chosen, scenes, depths, masks = [], [], [], [], []
        local = 0
        for name, row in demos:
            count = row["steps"]
            own = np.arange(row["first_step"], row["first_step"] + count)
            if not columns.hold(own, row["episode"]):
                raise self._contradiction(name, "does not begin at its first_step in the columns of its steps")
            with reading(self.path):
                demo = part(self._root, f"data/{name}")
                try:
                    scenes.append(stored_scenes(self._obs(demo, name, "scene", count)))
                    depth, mask = stored_end_effectors(self._obs(demo, name, "end_effector", count))
                except InputError as error:
                    raise self._contradiction(name, f"has a map that cannot be stored: {error.message}") from error
                self._compare(name, demo, {kind: array[own] for kind, array in columns.trajectory.items()})
            depths.append(depth)
            masks.append(mask)
            chosen.append(own)
            rows.append({**row, "first_step": local})
            local += count
        ee_row = np.arange(local, dtype=np.int32)
        maps = EncodedMaps(np.concatenate(scenes), ee_row, np.concatenate(depths), np.concatenate(masks))
        return Piece(episodes_table(rows, columns.version), columns.table.take(np.concatenate(chosen)), maps)

    def _obs(self, demo: h5py.Group, name: str, kind: str, count: int) -> Array:
        found = dataset(demo, f"obs/{kind}")
        wanted = (count, *_OBS[kind])
        if found.shape != wanted or found.dtype != obs_dtype(self._maps):
            what = f"holds {found.dtype} {found.shape}, not {obs_dtype(self._maps)} {wanted}"
            raise self._contradiction(name, f"is not as it was exported: obs/{kind} {what}")
        obs: Array = found[()]
        return obs

    def _compare(self, name: str, demo: h5py.Group, arrays: dict[str, Array]) -> None:
        """Take note of arrays for robomimic that do not follow from the columns any more."""
        for kind, array in arrays.items():
            found = values(demo, kind) if has(demo, kind) else np.empty(0)
            if found.shape != array.shape or not np.allclose(found, array, rtol=0, atol=_ROUNDING):
                self._changed[f"other {kind} than the columns say, which are imported"].append(name)

    def notes(self) -> list[str]:
        """What was changed by hand, as far as it has been read."""
        notes = []
        for what, names in self._changed.items():
            rest = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
            notes.append(f"{self.path.name}, {', '.join(names[:_NAMED])}{rest}: {what}")
        return notes


class _Columns:
    """The columns of a block's steps, and what follows from them."""

    def __init__(self, group: h5py.Group, version: int) -> None:
        self.version = version
        known = columns_at(STEP_COLUMNS, version)
        arrays = [from_array(values(group, column.name), column) for column in known]
        self.table = complete(pa.Table.from_arrays(arrays, schema=arrow_schema(known, version)), STEP_COLUMNS)
        self.trajectory = trajectory(self.table)
        self._episode, self._step = (self.table[name].to_numpy() for name in ("episode", "step"))

    def hold(self, rows: Array, episode: int) -> bool:
        """Whether these rows are the steps of this episode."""
        inside = rows[0] >= 0 and rows[-1] < self.table.num_rows
        return bool(
            inside and (self._episode[rows] == episode).all() and (self._step[rows] == np.arange(len(rows))).all()
        )
