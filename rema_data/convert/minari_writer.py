"""Writes blocks of one task as a Minari dataset; see ``minari`` for the layout.

A map is compressed once and stored as it is wherever it occurs: most hands are bare, and the last observation of an
episode is there twice. HDF5 is called below h5py, which needs longer for an episode than for its maps.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from rema_data.convert.folders import NewDataset
from rema_data.convert.hdf5_file import new_file
from rema_data.convert.hdf5_written import Written
from rema_data.convert.layout import INSTRUCTIONS, obs_of_end_effectors, obs_of_scenes, trajectory
from rema_data.convert.pieces import Piece
from rema_data.grid import ACTIONS, EE_PIXELS, SCENE_PIXELS
from rema_data.heights import dequantise, quantise
from rema_data.schema import TASKS

__all__ = [
    "HIGHEST_M",
    "MAIN",
    "METADATA",
    "dataset_name",
    "environment",
    "metadata",
    "scenario_name",
    "write_episodes",
]

Array = npt.NDArray[Any]

MAIN, METADATA = "data/main_data.hdf5", "data/metadata.json"
HIGHEST_M = 0.05
"""Of the observation space of the environments: what is higher is not seen."""
_MINARI = "0.5.3"
"""The version whose layout this is."""
_LEVEL = 6
_OUTCOME, _TEXT = "S24", h5py.string_dtype()


def environment(task: str) -> dict[str, Any]:
    """The specification of the environment of a task, as Gymnasium writes it."""
    name = "".join(word.capitalize() for word in task.split("_"))
    return {
        "id": f"rema/{name}-v1",
        "entry_point": "evaluator.gym.environment:TaskEnv",
        "reward_threshold": None,
        "nondeterministic": False,
        "max_episode_steps": None,
        "order_enforce": True,
        "disable_env_checker": False,
        "kwargs": {"task": task, "protocol": "end-to-end"},
        "additional_wrappers": [],
        "vector_entry_point": None,
    }


def scenario_name(row: dict[str, Any]) -> str:
    """The name by which the environment draws the objects of a collected episode again."""
    return f"collected/{row['seed']}/round-{row['round']}/{row['task']}/{row['split']}/{row['episode']}"


def dataset_name(task: str) -> str:
    """Name of a dataset, with the version that Minari wants in it."""
    return f"{task}-v1"


def metadata(dataset: NewDataset, size: int) -> str:
    """``metadata.json`` beside a file of so many bytes."""
    manifest = dataset.release.manifest
    steps = len(TASKS[dataset.task])
    top = float(dequantise(quantise(HIGHEST_M)))
    mask = np.broadcast_to(np.array([top, 1.0] * 2), (EE_PIXELS, EE_PIXELS, 4))
    observation = {
        "end_effector": _box(np.zeros(mask.shape), mask),
        "scene": _box(np.zeros((SCENE_PIXELS,) * 2), np.full((SCENE_PIXELS,) * 2, top)),
        "step": {"type": "Discrete", "dtype": "int64", "start": 0, "n": steps},
    }
    content = {
        "total_episodes": sum(block.episodes for block in dataset.blocks),
        "total_steps": sum(block.steps for block in dataset.blocks),
        "data_format": "hdf5",
        "jpeg_encoding": False,
        "observation_space": json.dumps({"type": "Dict", "subspaces": observation}),
        "action_space": json.dumps({"type": "Discrete", "dtype": "int64", "start": 0, "n": ACTIONS}),
        "env_spec": json.dumps(environment(dataset.task)),
        "dataset_id": dataset_name(dataset.task),
        "dataset_size": round(size / 1e6, 1),
        "minari_version": _MINARI,
        "algorithm_name": ", ".join(dict.fromkeys(policy for block in dataset.blocks for policy in block.policies)),
        "description": f"{INSTRUCTIONS[dataset.task]} From {manifest.name}: {manifest.title}. {manifest.citation}",
    }
    return json.dumps(content) + "\n"


def _box(low: Array, high: Array) -> dict[str, Any]:
    return {
        "type": "Box",
        "dtype": "float32",
        "shape": list(low.shape),
        "low": low.tolist(),
        "high": high.tolist(),
    }


def write_episodes(dataset: NewDataset) -> None:
    """Write ``main_data.hdf5``; OSError where the disk refuses."""
    with new_file(dataset.folder / MAIN) as (root, check, written):
        writer = _Writer(root.id, written)
        for block in dataset.blocks:
            for piece in dataset.pieces(block):
                writer.write(piece)
                check()


class _Writer:
    """Writes episodes and counts them."""

    def __init__(self, root: h5py.h5g.GroupID, written: Written) -> None:
        self._root, self._written = root, written
        self._count = 0
        self._scalar = h5py.h5s.create(h5py.h5s.SCALAR)
        self._untimed = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        self._untimed.set_obj_track_times(False)
        self._untimed_group = h5py.h5p.create(h5py.h5p.GROUP_CREATE)
        self._untimed_group.set_obj_track_times(False)  # equal exports are equal bytes

    def write(self, piece: Piece) -> None:
        """Append the episodes of a piece."""
        maps, about = piece.maps, trajectory(piece.steps)
        scenes = [zlib.compress(scene, _LEVEL) for scene in obs_of_scenes(maps.scene, "metres")]
        hands = [zlib.compress(hand, _LEVEL) for hand in obs_of_end_effectors(maps.ee_depth, maps.ee_mask, "metres")]
        outcomes = np.array(
            ["success" if text is None else text for text in piece.steps["failure"].to_pylist()], _OUTCOME
        )
        for row in piece.episodes.to_pylist():
            steps = range(row["first_step"], row["first_step"] + row["steps"])
            shown = [*steps, steps[-1]]
            at = slice(steps.start, steps.stop)
            group = self._group(self._root, f"episode_{self._count}")
            self._attributes(group, row)
            seen = self._group(group, "observations")
            self._packed(seen, "scene", [scenes[n] for n in shown], self._scene)
            self._packed(seen, "end_effector", [hands[maps.ee_row[n]] for n in shown], self._hand)
            self._array(seen, "step", np.array([*range(row["steps"]), row["steps"] - 1]))
            self._array(group, "actions", about["grid_index"][at])
            self._array(group, "rewards", about["rewards"][at].astype(np.float64))
            self._array(group, "terminations", about["dones"][at].astype(bool))
            self._array(group, "truncations", np.zeros(row["steps"], bool))
            infos = self._group(group, "infos")
            self._array(infos, "outcome", np.concatenate([np.zeros(1, _OUTCOME), outcomes[at]]))
            self._array(infos, "is_success", np.concatenate([[False], about["rewards"][at] > 0]))
            self._count += 1

    def _attributes(self, group: h5py.h5g.GroupID, row: dict[str, Any]) -> None:
        facts = {"split": row["split"], "failure": row["failure"] or "", "options/scenario": scenario_name(row)}
        numbers = {"id": self._count, "total_steps": row["steps"], "round": row["round"], "success": row["success"]}
        for name, fact in (facts | numbers).items():
            value = np.array(fact, _TEXT if isinstance(fact, str) else None)
            kind = h5py.h5t.py_create(value.dtype, logical=True)
            h5py.h5a.create(group, name.encode(), kind, self._scalar).write(value)

    def _group(self, parent: h5py.h5g.GroupID, name: str) -> h5py.h5g.GroupID:
        return h5py.h5g.create(parent, name.encode(), gcpl=self._untimed_group)

    def _array(self, parent: h5py.h5g.GroupID, name: str, array: Array) -> None:
        space = h5py.h5s.create_simple(array.shape)
        kind = h5py.h5t.py_create(array.dtype, logical=True)
        h5py.h5d.create(parent, name.encode(), kind, space, dcpl=self._untimed).write(
            h5py.h5s.ALL, h5py.h5s.ALL, np.ascontiguousarray(array)
        )
        self._written.array(f"{h5py.h5i.get_name(parent).decode()}/{name}", array)

    @cached_property
    def _scene(self) -> tuple[tuple[int, ...], Any]:
        return self._chunks(SCENE_PIXELS, SCENE_PIXELS)

    @cached_property
    def _hand(self) -> tuple[tuple[int, ...], Any]:
        return self._chunks(EE_PIXELS, EE_PIXELS, 4)

    def _chunks(self, *shape: int) -> tuple[tuple[int, ...], Any]:
        """Shape of a map, and how arrays of it are stored: a map a chunk."""
        properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        properties.set_obj_track_times(False)
        properties.set_chunk((1, *shape))
        properties.set_deflate(_LEVEL)
        return shape, properties

    def _packed(
        self, parent: h5py.h5g.GroupID, name: str, maps: Sequence[bytes], form: tuple[tuple[int, ...], Any]
    ) -> None:
        shape, properties = form
        space = h5py.h5s.create_simple((len(maps), *shape))
        made = h5py.h5d.create(parent, name.encode(), h5py.h5t.IEEE_F32LE, space, dcpl=properties)
        for number, data in enumerate(maps):
            made.write_direct_chunk((number, *(0 for _ in shape)), data)
