"""Compare what Minari sees in an export with the release, and play recorded actions in the environment it names.

    python benchmarks/minari_reader.py --python minari/bin/python --release rema-sample
    python benchmarks/minari_reader.py --python minari/bin/python --release rema-sample --task grasp_push

Minari is no dependency of rema: give it an environment of its own, with rema, and name its Python. Some episodes of
each dataset are played again with their recorded actions in the environment that ``recover_environment`` makes. Exits
with 6 if anything differs, or more outcomes than another machine than that of the release explains (docs/replay.md).
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from benchmarks.foreign import main_there, runs_there

INSTALL = "python -m venv minari && minari/bin/pip install 'minari[hdf5]>=0.5.3' -e '.[gym]'"
REPLAYED = 20
"""Episodes of a dataset that are played again."""
MOST_FLIPS = 2
"""Of these, how many may have another outcome: on another kind of processor, contact amplifies a last bit."""


def read_there(folder: Path) -> tuple[Iterator[dict[str, Any]], Any]:
    """Steps as Minari gives them, and the episodes that are played again."""
    os.environ["MINARI_DATASETS_PATH"] = str(folder.parent)
    import minari

    dataset = minari.load_dataset(folder.name)
    wrong: list[str] = []
    flips: list[str] = []

    def steps() -> Iterator[dict[str, Any]]:
        for episode in dataset:
            seen, count = episode.observations, len(episode)
            if any(len(maps) != count + 1 or not np.array_equal(maps[-1], maps[-2]) for maps in seen.values()):
                wrong.append(f"the last observation of episode {episode.id}")
            for n in range(count):
                yield {
                    **{name: maps[n] for name, maps in seen.items()},
                    "action": episode.actions[n],
                    "reward": episode.rewards[n],
                    "terminated": episode.terminations[n],
                    "truncated": episode.truncations[n],
                    "outcome": episode.infos["outcome"][n + 1].decode(),
                    "is_success": episode.infos["is_success"][n + 1],
                }

    def facts() -> dict[str, Any]:
        environment = dataset.recover_environment(disable_env_checker=True)
        chosen = range(0, len(dataset), max(1, len(dataset) // REPLAYED))
        told = dataset.storage.get_episode_metadata(chosen)
        for episode, about in zip(dataset.iterate_episodes(chosen), told, strict=True):
            seen, _ = environment.reset(options=about["options"])
            if any(not np.array_equal(maps[0], seen[name]) for name, maps in episode.observations.items()):
                wrong.append(f"the first observation of episode {episode.id}")
            for n, action in enumerate(episode.actions):
                _, reward, ended, _, info = environment.step(action)
                found = (info["outcome"].encode(), reward, ended)
                if found != (episode.infos["outcome"][n + 1], episode.rewards[n], episode.terminations[n]):
                    flips.append(f"episode {episode.id}, step {n}: {info['outcome']}")
                    break
        spaces, ours = dataset.observation_space.spaces, environment.observation_space.spaces
        if spaces != {name: space for name, space in ours.items() if name != "valid"}:
            wrong.append("the observation space")
        if dataset.action_space != environment.action_space:
            wrong.append("the action space")
        played = len(chosen)
        library = f"minari {version('minari')}, gymnasium {version('gymnasium')}"
        return {"id": dataset.env_spec.id, "played": played, "flips": flips, "wrong": wrong, "library": library}

    return steps(), facts


def expected(task: str) -> Any:
    """What the steps of a piece must be."""
    from rema_data.convert.layout import obs_of_end_effectors, obs_of_scenes, trajectory

    def steps(piece: Any) -> Iterator[dict[str, Any]]:
        maps, about = piece.maps, trajectory(piece.steps)
        scenes = obs_of_scenes(maps.scene, "metres")[..., 0]
        end_effectors = obs_of_end_effectors(maps.ee_depth, maps.ee_mask, "metres")
        for n, row in enumerate(piece.steps.to_pylist()):
            yield {
                "scene": scenes[n],
                "end_effector": end_effectors[maps.ee_row[n]],
                "step": np.int64(row["step"]),
                "action": np.int64(row["action"]),
                "reward": np.float64(about["rewards"][n]),
                "terminated": about["dones"][n] == 1,
                "truncated": np.bool_(False),
                "outcome": row["failure"] or "success",
                "is_success": about["rewards"][n] > 0,
            }

    return steps


def main() -> int:
    """Compare, or read in the other environment."""
    if runs_there():
        return main_there(read_there)
    from benchmarks.readers import compare

    facts = {
        "id": ("environment", lambda name: name.startswith("rema/")),
        "played": ("episodes played again", lambda count: count > 0),
        "flips": ("other outcomes", lambda names: len(names) <= MOST_FLIPS),
        "wrong": ("what differs", lambda names: not names),
    }
    return compare("minari", __file__, __doc__, INSTALL, expected, facts, lambda folder: folder.removesuffix("-v1"))


if __name__ == "__main__":
    sys.exit(main())
