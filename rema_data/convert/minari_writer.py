"""Writes blocks of one task as a Minari dataset; see ``minari`` for the layout.

A map is compressed once and stored as it is wherever it occurs: most hands are bare, and the last observation of an
episode is there twice.
"""

from __future__ import annotations

import json
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

from rema_data.convert.folders import NewDataset
from rema_data.convert.hdf5_file import new_file
from rema_data.convert.hdf5_written import MapForm, Written
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
_SCENE = MapForm((SCENE_PIXELS, SCENE_PIXELS), "<f4", _LEVEL)
_HAND = MapForm((EE_PIXELS, EE_PIXELS, 4), "<f4", _LEVEL)
_OUTCOME = "S24"


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
    with new_file(dataset.folder / MAIN, dataset.progress) as (written, check):
        count = 0
        for block in dataset.blocks:
            for piece in dataset.pieces(block):
                count = _write_piece(written, piece, count)
                check()


def _write_piece(written: Written, piece: Piece, count: int) -> int:
    """Append the episodes of a piece to so many that are there; how many there are then."""
    maps, about = piece.maps, trajectory(piece.steps)
    scenes = [zlib.compress(scene, _LEVEL) for scene in obs_of_scenes(maps.scene, "metres")]
    hands = [zlib.compress(hand, _LEVEL) for hand in obs_of_end_effectors(maps.ee_depth, maps.ee_mask, "metres")]
    outcomes = np.array(["success" if text is None else text for text in piece.steps["failure"].to_pylist()], _OUTCOME)
    for number, row in enumerate(piece.episodes.to_pylist(), count):
        steps = range(row["first_step"], row["first_step"] + row["steps"])
        shown = [*steps, steps[-1]]
        at = slice(steps.start, steps.stop)
        group = written.group(written.root, f"episode_{number}")
        facts = {"split": row["split"], "failure": row["failure"] or "", "options/scenario": scenario_name(row)}
        numbers = {"id": number, "total_steps": row["steps"], "round": row["round"], "success": row["success"]}
        written.attributes(group, facts | numbers)
        seen = written.group(group, "observations")
        written.maps(seen, "scene", [scenes[n] for n in shown], _SCENE)
        written.maps(seen, "end_effector", [hands[maps.ee_row[n]] for n in shown], _HAND)
        written.array(seen, "step", np.array([*range(row["steps"]), row["steps"] - 1]))
        written.array(group, "actions", about["grid_index"][at])
        written.array(group, "rewards", about["rewards"][at].astype(np.float64))
        written.array(group, "terminations", about["dones"][at].astype(bool))
        written.array(group, "truncations", np.zeros(row["steps"], bool))
        infos = written.group(group, "infos")
        written.array(infos, "outcome", np.concatenate([np.zeros(1, _OUTCOME), outcomes[at]]))
        written.array(infos, "is_success", np.concatenate([[False], about["rewards"][at] > 0]))
    return count + len(piece.episodes)
