"""Writes the blocks of one task into one HDF5 file; see ``hdf5`` for the layout."""

from __future__ import annotations

import json
import zlib
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from h5py import h5d, h5g

from rema_data import interrupts
from rema_data.convert.base import ExportedFile, ExportPlan
from rema_data.convert.hdf5_file import FORMAT, VERSION, new_file, open_file, reading
from rema_data.convert.hdf5_written import MapForm, Written
from rema_data.convert.layout import obs_dtype, obs_of_end_effectors, obs_of_scenes, to_array, trajectory
from rema_data.convert.pieces import Piece, read_pieces
from rema_data.errors import RunMismatchError
from rema_data.grid import EE_PIXELS, SCENE_PIXELS
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
"""More than a demo has."""


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
        with new_file(path, progress) as (written, check):
            _Writer(written, check, plan, progress).write(task, blocks)
            written.attributes(written.group(written.root, "rema"), identity)
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

    def __init__(self, written: Written, check: Callable[[], None], plan: ExportPlan, progress: Progress) -> None:
        self._written = written
        self._check = check
        self._release = plan.release
        self._options = plan.options
        self._progress = progress
        self._data = written.group(written.root, "data")
        dtype = obs_dtype(plan.options.maps)
        self._forms = {
            "scene": MapForm((SCENE_PIXELS, SCENE_PIXELS, 1), dtype, _GZIP_LEVEL),
            "end_effector": MapForm((EE_PIXELS, EE_PIXELS, 4), dtype, _GZIP_LEVEL),
        }
        self._demos = 0
        self._filters: defaultdict[str, list[str]] = defaultdict(list)

    def write(self, task: str, blocks: Sequence[BlockEntry]) -> None:
        release, written = self._release, self._written
        rema = written.group(written.root, "rema")
        self._write_bytes(rema, "manifest", release.manifest.to_bytes())
        card = written.group(rema, "card")
        own = [file for file in release.manifest.files if file.block is None and release.has(file)]
        for number, file in enumerate(own):
            made = self._write_bytes(card, str(number), release.file(file).read_bytes())
            written.attributes(made, {"path": file.path})
        for block in blocks:
            reader = release.block(block)
            self._write_columns(written.group(rema, block.key.path), reader, release.manifest.schema_version)
            first_step = 0
            for piece in read_pieces(reader):
                self._write_piece(piece, first_step)
                first_step += piece.steps.num_rows
                self._progress.advance(piece.steps.num_rows)
        environment = {"env_name": f"rema-{task}", "type": _GYM, "env_kwargs": {"task": task}}
        steps = sum(block.steps for block in blocks)
        written.attributes(self._data, {"total": steps, "env_args": json.dumps(environment)})
        mask = written.group(written.root, "mask")
        for name, demos in self._filters.items():
            written.array(mask, name, np.array(demos, "S"))
        if "val" in self._filters:
            mask.links.create_hard(b"valid", mask, b"val")  # robomimic's own name for it

    def _write_piece(self, piece: Piece, first_step: int) -> None:
        maps, written = piece.maps, self._written
        scenes = obs_of_scenes(maps.scene, self._options.maps)
        hands = obs_of_end_effectors(maps.ee_depth, maps.ee_mask, self._options.maps)
        packed = {
            "scene": ([zlib.compress(scene, _GZIP_LEVEL) for scene in scenes], range(len(scenes))),
            "end_effector": ([zlib.compress(hand, _GZIP_LEVEL) for hand in hands], maps.ee_row.tolist()),
        }
        arrays = trajectory(piece.steps)
        for row in as_stored(piece.episodes, EPISODE_COLUMNS).to_pylist():
            begin, end = row["first_step"], row["first_step"] + row["steps"]
            row["first_step"] += first_step
            demo = self._new_demo(row)
            for name, array in arrays.items():
                written.array(demo, name, array[begin:end])
            obs = written.group(demo, "obs")
            for name, (stored, rows) in packed.items():
                written.maps(obs, name, [stored[n] for n in rows[begin:end]], self._forms[name])
            if self._options.next_obs:
                obs = written.group(demo, "next_obs")
                for name, (stored, rows) in packed.items():
                    following = [*rows[begin + 1 : end], rows[end - 1]]
                    written.maps(obs, name, [stored[n] for n in following], self._forms[name])
            self._check()
            interrupts.check()

    def _new_demo(self, row: dict[str, Any]) -> h5g.GroupID:
        name = f"demo_{self._demos}"
        self._demos += 1
        demo = self._written.group(self._data, name, _COMPACT_ATTRIBUTES)
        about = {"num_samples": row["steps"]}
        for column in EPISODE_COLUMNS:
            value = row.get(column.name)
            if value is not None:
                about[column.name] = value if column.type == "string" else np.dtype(column.type).type(value)
        self._written.attributes(demo, about)
        names = [row["split"], f"round_{row['round']}", f"round_{row['round']}_{row['split']}"]
        if row["success"]:
            names += [f"{row['split']}_success", "success"]
        for filter_key in names:
            self._filters[filter_key].append(name)
        return demo

    def _write_columns(self, group: h5g.GroupID, reader: BlockReader, usual_version: int) -> None:
        steps = reader.steps()
        version = reader.version()
        if version != usual_version:  # a block of an earlier release
            self._written.attributes(group, {"schema_version": version})
        for column in columns_at(STEP_COLUMNS, version):
            made = self._written.array(group, column.name, to_array(steps[column.name], column), packed=True)
            notes = {"meaning": column.meaning, "unit": column.unit, "frame": column.frame}
            self._written.attributes(made, {key: text for key, text in notes.items() if text})

    def _write_bytes(self, group: h5g.GroupID, name: str, data: bytes) -> h5d.DatasetID:
        return self._written.array(group, name, np.frombuffer(data, np.uint8), packed=True)
