"""Does Hugging Face ``datasets`` see in an export what the release holds? Every column of every step is compared.

    python benchmarks/hf_reader.py --python datasets/bin/python --release rema-sample

Give ``datasets`` an environment of its own, without rema, and name its Python. Exits with 6 if a number differs.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from benchmarks.foreign import main_there, runs_there

INSTALL = "python -m venv datasets && datasets/bin/pip install datasets"
MAPS = ("scene", "end_effector")
BATCH = 64
ORDER = ("grasp", "push", "grasp_grasp", "grasp_push", "grasp_grasp_push")


def read_there(folder: Path) -> tuple[Iterator[dict[str, Any]], Any]:
    """Rows as ``datasets`` gives them."""
    folder_of_cache = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
    cache = folder_of_cache.name
    os.environ |= {"HF_HUB_OFFLINE": "1", "HF_HOME": cache, "HF_DATASETS_CACHE": cache}
    import datasets

    configurations = sorted(datasets.get_dataset_config_names(str(folder)), key=ORDER.index)

    def rows() -> Iterator[dict[str, Any]]:
        for configuration in configurations:
            for split in datasets.load_dataset(str(folder), configuration).values():
                columns = [name for name in split.column_names if name not in MAPS]
                maps, others = split.select_columns(list(MAPS)).with_format("numpy"), split.select_columns(columns)
                for start in range(0, len(split), BATCH):  # as a loader asks for them: a row alone takes much longer
                    rows = slice(start, min(start + BATCH, len(split)))
                    seen, told = maps[rows], others[rows]
                    for n in range(rows.stop - rows.start):
                        plain = {name: repr(values[n]) for name, values in told.items()}
                        yield {**{name: values[n] for name, values in seen.items()}, **plain}
            shutil.rmtree(cache, ignore_errors=True)  # 217 kB a step: one task at a time

    def facts() -> dict[str, Any]:
        folder_of_cache.cleanup()
        library = f"datasets {datasets.__version__}"
        return {"configurations": ", ".join(configurations), "library": library}

    return rows(), facts


def expected(task: str) -> Any:
    """What the rows of a piece must be."""
    from rema_data.convert.layout import obs_of_end_effectors, obs_of_scenes

    def rows(piece: Any) -> Iterator[dict[str, Any]]:
        maps = piece.maps
        scenes = obs_of_scenes(maps.scene, "metres")[..., 0]
        end_effectors = np.moveaxis(obs_of_end_effectors(maps.ee_depth, maps.ee_mask, "metres"), -1, 1)
        seeds = {row["episode"]: row["seed"] for row in piece.episodes.to_pylist()}
        for n, row in enumerate(piece.steps.to_pylist()):
            plain = {name: value for name, value in row.items() if name not in ("scene_row", "ee_row")}
            plain["seed"] = seeds[row["episode"]]
            yield {
                "scene": scenes[n],
                "end_effector": end_effectors[maps.ee_row[n]],
                **{name: repr(value) for name, value in plain.items()},
            }

    return rows


def main() -> int:
    """Compare, or read in the other environment."""
    if runs_there():
        return main_there(read_there)
    from benchmarks.readers import compare

    facts = {"configurations": ("configurations", bool)}
    return compare("hf", __file__, __doc__, INSTALL, expected, facts, lambda folder: None)


if __name__ == "__main__":
    sys.exit(main())
