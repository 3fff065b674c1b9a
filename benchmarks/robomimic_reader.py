"""Does robomimic's own reader see in an export what the release holds? Every step of every split is compared.

    python benchmarks/robomimic_reader.py --release rema-sample        # all tasks of a release
    python benchmarks/robomimic_reader.py --release rema-mini --task grasp_push

Needs robomimic, which is no dependency of rema; its reader does without the packages that robomimic renders with. Exits
with 6 if a number differs.
"""

from __future__ import annotations

import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from rich.table import Table

from benchmarks.results import finish, parser, target
from rema_data.convert import ExportedFile, export_release
from rema_data.convert.layout import obs_of_end_effectors, obs_of_scenes, trajectory
from rema_data.convert.pieces import read_pieces
from rema_data.release.folder import ReleaseFolder, find_release

INSTALL = "pip install --no-deps robomimic==0.3.0 && pip install tqdm termcolor"
OBS = ["scene", "end_effector"]
KEYS = ["actions", "rewards", "dones", "grid_index"]


def import_reader() -> Any:
    """The dataset class of robomimic, or an exit with the command that installs it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from robomimic.utils.dataset import SequenceDataset
    except ImportError as error:
        sys.exit(f"robomimic cannot be imported ({error}); install it: {INSTALL}")
    return SequenceDataset


def compare(reader: Any, file: ExportedFile, release: ReleaseFolder, split: str) -> tuple[int, int, float]:
    """Steps read through a filter key, how many of them differ from the release, and the seconds that reading took."""
    task = file.path.stem
    found = reader(str(file.path), OBS, KEYS, load_next_obs=False, filter_by_attribute=split)
    row = different = 0
    seconds = 0.0
    for block in release.manifest.select([task], split=split):
        for piece in read_pieces(release.block(block)):
            maps = piece.maps
            scenes = obs_of_scenes(maps.scene, "metres")
            end_effectors = obs_of_end_effectors(maps.ee_depth, maps.ee_mask, "metres")
            arrays = trajectory(piece.steps)
            for step in range(piece.steps.num_rows):
                start = time.perf_counter()
                item = found[row]
                seconds += time.perf_counter() - start
                row += 1
                wanted = {"scene": scenes[step], "end_effector": end_effectors[maps.ee_row[step]]}
                same = all(np.array_equal(item["obs"][name][0], obs) for name, obs in wanted.items())
                same &= all(np.array_equal(item[name][0], array[step]) for name, array in arrays.items())
                different += not same
    return row, different + abs(len(found) - row), seconds


def main() -> int:
    """Export, compare and print; the exit code is 6 if a step differs."""
    options = parser(__doc__)
    options.add_argument("--release", help="name or folder (default: the newest here)")
    options.add_argument("--task", action="append", help="only this one (repeatable)")
    arguments = options.parse_args()
    reader = import_reader()
    release = find_release(arguments.release)
    table = Table(
        "task", "filter key", "steps", "different", "steps/s", title="robomimic's SequenceDataset on an export"
    )
    for column in table.columns[2:]:
        column.justify = "right"
    numbers: dict[str, Any] = {"release": release.manifest.name, "rows": []}
    with tempfile.TemporaryDirectory() as folder:
        for file in export_release(release, Path(folder), tasks=arguments.task):
            splits = sorted({block.split for block in release.manifest.select([file.path.stem])})
            for split in splits:
                steps, different, seconds = compare(reader, file, release, split)
                rate = steps / seconds
                table.add_row(file.path.stem, split, str(steps), str(different), f"{rate:,.0f}")
                row = {"task": file.path.stem, "split": split, "steps": steps, "different": different, "rate": rate}
                numbers["rows"].append(row | {"bytes": file.bytes, "bytes_per_step": file.bytes / file.steps})
    wrong = sum(row["different"] for row in numbers["rows"])
    targets = [target("steps that differ", "0", str(wrong), not wrong)]
    return finish(arguments, "robomimic_reader", [table], targets, [], numbers, mismatch=bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
