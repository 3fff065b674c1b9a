"""Writes the blocks of one task into one HDF5 file; see ``hdf5`` for the layout."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from rema_data import interrupts
from rema_data.convert.base import ExportedFile, ExportPlan
from rema_data.convert.hdf5_file import FORMAT, VERSION, new_file, open_file, reading
from rema_data.convert.hdf5_written import Written
from rema_data.convert.layout import obs_of_end_effectors, obs_of_scenes, to_array, trajectory
from rema_data.convert.pieces import Piece, read_pieces
from rema_data.errors import RunMismatchError
from rema_data.heights import HEIGHT_OFFSET_M
from rema_data.progress import Progress
from rema_data.release.manifest import BlockEntry
from rema_data.schema import HEIGHT_STEP_M
from rema_data.store.block import BlockReader
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS, columns_at
from rema_data.store.tables import as_stored

__all__ = ["write_file"]

_GZIP_LEVEL = 9
_GYM = 2
"""What robomimic calls an environment that is neither robosuite's nor iGibson's; it is looked at only for rollouts."""
_COMPACT_ATTRIBUTES = 32
"""An object with more attributes keeps them in a heap of its own, of some 1.4 kB."""

Array = npt.NDArray[Any]


def write_file(plan: ExportPlan, task: str, blocks: Sequence[BlockEntry], progress: Progress) -> ExportedFile:
    """Write the file of one task, unless the same one is there already."""
    path = plan.target / f"{task}.hdf5"
    identity = _identity(plan, blocks)
    episodes, steps = (sum(getattr(block, name) for block in blocks) for name in ("episodes", "steps"))
    new = not path.exists()
    if not new:
        with open_file(path) as root, reading(path):
            if dict(root["rema"].attrs if "rema" in root else {}) != identity:
                raise RunMismatchError(
                    f"{path} is there already, and is another export",
                    hint="export into another folder, or move the file away",
                    path=str(path),
                )
    else:
        progress.phase(f"export {task}", steps)
        with new_file(path) as (root, check, written):
            _Writer(root, check, written, plan, progress).write(task, blocks)
            root["rema"].attrs.update(identity)
            written.attributes("/rema", identity)
    return ExportedFile(path, episodes, steps, path.stat().st_size, new)


def _identity(plan: ExportPlan, blocks: Sequence[BlockEntry]) -> dict[str, Any]:
    """Attributes of the group ``rema``: equal ones mean equal files."""
    manifest = plan.release.manifest
    return {
        "format": FORMAT,
        "format_version": VERSION,
        "schema_version": manifest.schema_version,
        "release": manifest.name,
        "release_sha256": manifest.sha256,
        "blocks": " ".join(block.key.path for block in blocks),
        "maps": plan.options.maps,
        "next_obs": plan.options.next_obs,
        "quantised_step_m": HEIGHT_STEP_M,
        "quantised_offset_m": HEIGHT_OFFSET_M,
    }


class _Writer:
    """Writes into a new file and counts its demos."""

    def __init__(
        self, root: h5py.File, check: Callable[[], None], written: Written, plan: ExportPlan, progress: Progress
    ) -> None:
        self._root = root
        self._check = check
        self._written = written
        self._release = plan.release
        self._options = plan.options
        self._progress = progress
        self._data = root.create_group("data")
        self._demos = 0
        self._filters: defaultdict[str, list[str]] = defaultdict(list)

    def write(self, task: str, blocks: Sequence[BlockEntry]) -> None:
        release, rema = self._release, _group(self._root, "rema")
        self._write_bytes(rema, "manifest", release.manifest.to_bytes())
        card = _group(rema, "card")
        own = [file for file in release.manifest.files if file.block is None and release.has(file)]
        for number, file in enumerate(own):
            self._write_bytes(card, str(number), release.file(file).read_bytes()).attrs["path"] = file.path
            self._written.attributes(f"{card.name}/{number}", {"path": file.path})
        for block in blocks:
            reader = release.block(block)
            self._write_columns(_group(rema, block.key.path), reader, release.manifest.schema_version)
            first_step = 0
            for piece in read_pieces(reader):
                self._write_piece(piece, first_step)
                first_step += piece.steps.num_rows
                self._progress.advance(piece.steps.num_rows)
        environment = {"env_name": f"rema-{task}", "type": _GYM, "env_kwargs": {"task": task}}
        about = {"total": sum(block.steps for block in blocks), "env_args": json.dumps(environment)}
        for name, value in about.items():
            self._data.attrs[name] = value
        self._written.attributes(self._data.name, about)
        mask = _group(self._root, "mask")
        for name, demos in self._filters.items():
            self._put(mask, name, np.array(demos, "S"))
        if "val" in mask:
            mask["valid"] = mask["val"]  # robomimic's own name for it

    def _write_piece(self, piece: Piece, first_step: int) -> None:
        maps, options = piece.maps, self._options
        scenes = obs_of_scenes(maps.scene, options.maps)
        end_effectors = obs_of_end_effectors(maps.ee_depth, maps.ee_mask, options.maps)
        arrays = trajectory(piece.steps)
        for row in as_stored(piece.episodes, EPISODE_COLUMNS).to_pylist():
            rows = slice(row["first_step"], row["first_step"] + row["steps"])
            row["first_step"] += first_step
            demo = self._new_demo(row)
            for name, array in arrays.items():
                self._put(demo, name, array[rows])
            seen = {"scene": scenes[rows], "end_effector": end_effectors[maps.ee_row[rows]]}
            for name, obs in seen.items():
                self._write_obs(demo, "obs", name, obs)
                if options.next_obs:
                    self._write_obs(demo, "next_obs", name, np.concatenate([obs[1:], obs[-1:]]))
            self._check()
            interrupts.check()

    def _new_demo(self, row: dict[str, Any]) -> h5py.Group:
        name = f"demo_{self._demos}"
        self._demos += 1
        properties = h5py.h5p.create(h5py.h5p.GROUP_CREATE)
        properties.set_attr_phase_change(_COMPACT_ATTRIBUTES, _COMPACT_ATTRIBUTES // 2)
        properties.set_obj_track_times(False)
        demo = h5py.Group(h5py.h5g.create(self._data.id, name.encode(), gcpl=properties))
        about = {"num_samples": row["steps"]}
        for column in EPISODE_COLUMNS:
            value = row.get(column.name)
            if value is not None:
                about[column.name] = value if column.type == "string" else np.dtype(column.type).type(value)
        for key, value in about.items():
            demo.attrs[key] = value
        self._written.attributes(demo.name, about)
        names = [row["split"], f"round_{row['round']}", f"round_{row['round']}_{row['split']}"]
        if row["success"]:
            names += [f"{row['split']}_success", "success"]
        for filter_key in names:
            self._filters[filter_key].append(name)
        return demo

    def _put(self, group: h5py.Group, name: str, array: Array) -> None:
        group[name] = array
        self._written.array(f"{group.name}/{name}", array)

    def _create(self, group: h5py.Group, name: str, array: Array, **options: Any) -> h5py.Dataset:
        self._written.array(f"{group.name}/{name}", array)
        return group.create_dataset(name, data=array, **options)

    def _write_obs(self, demo: h5py.Group, group: str, name: str, obs: Array) -> None:
        packed = {"compression": "gzip", "compression_opts": _GZIP_LEVEL}
        self._create(_group(demo, group), name, obs, chunks=(1, *obs.shape[1:]), **packed)

    def _write_columns(self, group: h5py.Group, reader: BlockReader, usual_version: int) -> None:
        steps = reader.steps()
        version = reader.version()
        if version != usual_version:  # a block of an earlier release
            group.attrs["schema_version"] = version
            self._written.attributes(group.name, {"schema_version": version})
        for column in columns_at(STEP_COLUMNS, version):
            array = to_array(steps[column.name], column)
            packed = {"compression": "gzip", "shuffle": True} if len(array) else {}
            dataset = self._create(group, column.name, array, **packed)
            notes = {"meaning": column.meaning, "unit": column.unit, "frame": column.frame}
            dataset.attrs.update({key: text for key, text in notes.items() if text})

    def _write_bytes(self, group: h5py.Group, name: str, data: bytes) -> h5py.Dataset:
        packed = {"compression": "gzip"} if data else {}
        return self._create(group, name, np.frombuffer(data, np.uint8), **packed)


def _group(parent: h5py.Group, path: str) -> h5py.Group:
    """A group, and those on the way to it. HDF5 would make these of itself, and write the time into them."""
    for name in path.split("/"):
        parent = parent[name] if name in parent else parent.create_group(name)
    return parent
