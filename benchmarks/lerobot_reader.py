"""Does LeRobot's own reader see in an export what the release holds? Every step and every statistic is compared.

    python benchmarks/lerobot_reader.py --python lerobot/bin/python --release rema-sample
    python benchmarks/lerobot_reader.py --python lerobot/bin/python --release rema-mini --task grasp_push

LeRobot needs Python 3.12 and is no dependency of rema: give it an environment of its own, and name its Python. Exits
with 6 if a number differs.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from benchmarks.foreign import main_there, runs_there

INSTALL = "python3.12 -m venv lerobot && lerobot/bin/pip install 'lerobot[dataset]>=0.6'"
MAPS = ("observation.scene", "observation.end_effector")
TEXTS = ("primitive", "embodiment", "policy", "failure", "task")
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
TOLERANCE = 1e-9


def read_there(folder: Path) -> tuple[Iterator[dict[str, Any]], Any]:
    """Frames as LeRobot gives them, and a comparison of its statistics with those of the frames."""
    folder_of_cache = tempfile.TemporaryDirectory()
    cache = folder_of_cache.name
    os.environ |= {"HF_HUB_OFFLINE": "1", "HF_HOME": cache, "HF_DATASETS_CACHE": cache, "HF_LEROBOT_HOME": cache}
    import lerobot
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("rema/export", root=folder)
    counts: defaultdict[tuple[str, int], Counter[float]] = defaultdict(Counter)
    columns: defaultdict[str, list[Any]] = defaultdict(list)

    def frames() -> Iterator[dict[str, Any]]:
        for row in range(len(dataset)):
            item = {name: value if name in TEXTS else value.numpy() for name, value in dataset[row].items()}
            for name in MAPS:
                for plane, values in enumerate(item[name]):
                    heights, times = np.unique(values, return_counts=True)
                    counts[name, plane].update(dict(zip(heights.tolist(), times.tolist(), strict=True)))
            for name in item.keys() - {*MAPS, *TEXTS}:
                columns[name].append(np.atleast_1d(item[name]))
            yield item

    def facts() -> dict[str, Any]:
        stats = dataset.meta.stats
        wrong = list({*MAPS, *columns} ^ set(stats))
        for name in MAPS:
            planes = [_of_counts(counts[name, n]) for n in range(len(stats[name]["mean"]))]
            wanted = {key: np.reshape([plane[key] for plane in planes], (-1, 1, 1)) for key in planes[0]}
            wrong += _different(name, stats[name], wanted, len(dataset))
        for name, values in columns.items():
            wrong += _different(name, stats[name], _of_values(np.stack(values).astype(np.float64)), len(dataset))
        meta = dataset.meta
        splits = sum(int(end) - int(start) for start, end in (text.split(":") for text in meta.info["splits"].values()))
        whole = splits == meta.total_episodes and sum(meta.episodes["length"]) == len(dataset) == meta.total_frames
        folder_of_cache.cleanup()  # 217 kB a step
        return {"statistics": sorted(wrong), "whole": bool(whole), "library": f"lerobot {lerobot.__version__}"}

    return frames(), facts


def _of_values(values: Any) -> dict[str, Any]:
    quantiles = {name: np.quantile(values, share, axis=0) for name, share in QUANTILES.items()}
    return {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0), **quantiles}


def _of_counts(counts: Counter[float]) -> dict[str, Any]:
    values = np.array(sorted(counts))
    times = np.array([counts[value] for value in values.tolist()])
    mean = np.average(values, weights=times)
    ends = np.cumsum(times)

    def quantile(share: float) -> float:
        place = share * (ends[-1] - 1)
        around = [values[np.searchsorted(ends, n, side="right")] for n in (np.floor(place), np.ceil(place))]
        return float(np.interp(place % 1, (0, 1), around))

    std = np.sqrt(np.average((values - mean) ** 2, weights=times))
    return {"min": values[0], "max": values[-1], "mean": mean, "std": std} | {
        name: quantile(share) for name, share in QUANTILES.items()
    }


def _different(name: str, found: dict[str, Any], wanted: dict[str, Any], count: int) -> list[str]:
    keys = wanted.keys() ^ (found.keys() - {"count"})
    wrong = [f"{name}/{key}" for key in keys] + ([f"{name}/count"] if found["count"].tolist() != [count] else [])
    for key in wanted.keys() & found.keys():
        same = found[key].shape == wanted[key].shape and np.allclose(found[key], wanted[key], TOLERANCE, TOLERANCE)
        wrong += [] if same else [f"{name}/{key}"]
    return wrong


def expected(task: str) -> Any:
    """What the frames of a piece must be."""
    from rema_data.convert.layout import INSTRUCTIONS, obs_of_end_effectors, obs_of_scenes, trajectory

    episode, index = -1, -1

    def steps(piece: Any) -> Iterator[dict[str, Any]]:
        nonlocal episode, index
        maps, about = piece.maps, trajectory(piece.steps)
        scenes = np.moveaxis(obs_of_scenes(maps.scene, "metres"), -1, 1)
        end_effectors = np.moveaxis(obs_of_end_effectors(maps.ee_depth, maps.ee_mask, "metres"), -1, 1)
        for n, row in enumerate(piece.steps.to_pylist()):
            episode, index = episode + (row["step"] == 0), index + 1
            won = about["rewards"][n]
            yield {
                "observation.scene": scenes[n],
                "observation.end_effector": end_effectors[maps.ee_row[n]],
                "action": about["actions"][n],
                "grid_index": about["grid_index"][n],
                "next.reward": won,
                "next.done": about["dones"][n] == 1,
                "next.success": won == 1,
                "timestamp": np.float32(row["step"]),
                "frame_index": np.int64(row["step"]),
                "episode_index": np.int64(episode),
                "index": np.int64(index),
                "task_index": np.int64(0),
                "task": INSTRUCTIONS[task],
                **{name: row[name] or "" for name in TEXTS if name != "task"},
            }

    return steps


def main() -> int:
    """Compare, or read in the other environment."""
    if runs_there():
        return main_there(read_there)
    from benchmarks.readers import compare

    facts = {
        "statistics": ("statistics that differ", lambda names: not names),
        "whole": ("counts and splits add up", bool),
    }
    return compare("lerobot", __file__, __doc__, INSTALL, expected, facts)


if __name__ == "__main__":
    sys.exit(main())
