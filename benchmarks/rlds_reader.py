"""Does TensorFlow Datasets see in an export what the release holds? Every step of every split is compared.

    python benchmarks/rlds_reader.py --python tfds/bin/python --release rema-sample

TensorFlow is no dependency of rema: give it an environment of its own, without rema, and name its Python. Exits with 6
if a number differs.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from benchmarks.foreign import main_there, runs_there

INSTALL = "python -m venv tfds && tfds/bin/pip install tensorflow-cpu tensorflow-datasets"
TEXTS = ("language_instruction", "primitive", "embodiment", "policy", "failure")
EPISODE = ("round", "split", "episode", "seed", "success", "failure", "failed_step")


def read_there(folder: Path) -> tuple[Iterator[dict[str, Any]], Any]:
    """Steps as TensorFlow Datasets gives them."""
    os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"
    import tensorflow as tf
    import tensorflow_datasets as tfds

    builder = tfds.builder_from_directory(str(folder))
    in_order = tfds.ReadConfig(interleave_cycle_length=1)  # one file after another
    counted = 0

    def with_episode(episode: dict[str, Any]) -> Any:
        return episode["steps"].map(lambda step: {**step, "episode": episode["episode_metadata"]})

    def steps() -> Iterator[dict[str, Any]]:
        nonlocal counted
        for split in builder.info.splits:
            episodes = builder.as_dataset(split=split, read_config=in_order)
            for step in tfds.as_numpy(episodes.flat_map(with_episode)):  # an iterator an episode takes much longer
                counted += bool(step["is_first"])
                about = step["episode"]
                texts = {name: value.decode() if isinstance(value, bytes) else value for name, value in about.items()}
                apart = (*TEXTS, "observation", "episode")
                yield {
                    **step["observation"],
                    **{name: value for name, value in step.items() if name not in apart},
                    **{name: step[name].decode() for name in TEXTS},
                    **{f"episode_{name}": value for name, value in texts.items()},
                }

    def facts() -> dict[str, Any]:
        whole = counted == sum(split.num_examples for split in builder.info.splits.values())
        library = f"tensorflow-datasets {tfds.__version__}, tensorflow {tf.__version__}"
        return {"splits": ", ".join(builder.info.splits), "whole": whole, "library": library}

    return steps(), facts


def expected(task: str) -> Any:
    """What the steps of a piece must be."""
    from rema_data.convert.layout import INSTRUCTIONS, obs_of_end_effectors, obs_of_scenes, trajectory

    def steps(piece: Any) -> Iterator[dict[str, Any]]:
        maps, about = piece.maps, trajectory(piece.steps)
        scenes = obs_of_scenes(maps.scene, "metres")
        end_effectors = obs_of_end_effectors(maps.ee_depth, maps.ee_mask, "metres")
        episodes = {row["episode"]: row for row in piece.episodes.to_pylist()}
        for n, row in enumerate(piece.steps.to_pylist()):
            episode = episodes[row["episode"]]
            yield {
                "scene": scenes[n],
                "end_effector": end_effectors[maps.ee_row[n]],
                "action": about["actions"][n],
                "grid_index": about["grid_index"][n],
                "reward": about["rewards"][n],
                "discount": np.float32(1 - about["dones"][n]),
                "is_first": np.bool_(row["step"] == 0),
                "is_last": np.bool_(row["step"] == episode["steps"] - 1),
                "is_terminal": about["dones"][n] == 1,
                "language_instruction": INSTRUCTIONS[task],
                **{name: row[name] or "" for name in TEXTS if name != "language_instruction"},
                **{f"episode_{name}": _as_told(episode[name], name) for name in EPISODE},
            }

    return steps


def _as_told(value: Any, name: str) -> Any:
    if name in ("split", "seed", "failure"):
        return "" if value is None else str(value)
    return np.bool_(value) if name == "success" else np.int64(-1 if value is None else value)


def main() -> int:
    """Compare, or read in the other environment."""
    if runs_there():
        return main_there(read_there)
    from benchmarks.readers import compare

    facts = {"splits": ("splits", bool), "whole": ("counts add up", bool)}
    return compare("rlds", __file__, __doc__, INSTALL, expected, facts)


if __name__ == "__main__":
    sys.exit(main())
