"""The readers that ``read.py`` compares with: the same steps, stored as others store them and read as they read them.

Each peer writes float32 maps once and gives a function from row numbers to a batch: scene (N, 64, 64) and end effector
(N, 4, 112, 112) as float32 tensors on the CPU, action and success. Where a peer leaves a choice, the quicker one is
taken: files stay open, rows are written into a batch that is allocated once, and every step is an episode of its own,
so that nobody reads steps that were not asked for.
"""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
import torch
import zarr
from torch import Tensor

from rema_data.heights import dequantise, unpack_mask
from rema_data.loader.batch import FloatBatch
from rema_data.loader.dataset import StepDataset
from rema_data.loader.release import Release
from rema_data.schema import HEIGHT_STEP_M
from rema_data.store.block import BlockKey
from rema_data.store.maps import ARRAYS, MAPS

Rows = npt.NDArray[np.int64]
SCENE, END_EFFECTOR = (64, 64), (4, 112, 112)
PIECE = 256
PARQUET_ROWS = 1000
"""Of a file."""
EPISODE = 200
"""Frames of LeRobot that are held until they are written."""
CACHE = "cache"
"""Folder of what a peer unpacks for itself, beside its files."""
INSTALL = "python3.12 -m venv all && all/bin/pip install 'lerobot[dataset]>=0.6' 'minari>=0.5.4' pillow -e '.[gym]'"


class Batch(NamedTuple):
    """What every reader gives."""

    scene: Tensor
    end_effector: Tensor
    action: Tensor
    success: Tensor


Read = Callable[[Rows], Batch]


@dataclass(frozen=True)
class Samples:
    """The steps that are compared: rows of a dataset of a release. Readers number them from 0.

    Attributes
    ----------
    release : Release
    quantised, float32 : StepDataset
        The same selection in both deliveries.
    rows : int64 (N,)
        Rows of the dataset.
    steps : DataFrame
        Their rows of the release's step tables.
    """

    release: Release
    quantised: StepDataset
    float32: StepDataset
    rows: Rows
    steps: pd.DataFrame

    def pieces(self) -> Iterator[FloatBatch]:
        """All samples as float32, in order, some at a time."""
        for start in range(0, len(self.rows), PIECE):
            piece = self.float32.__getitems__(self.rows[start : start + PIECE])
            assert isinstance(piece, FloatBatch)
            yield piece

    def each(self) -> Iterator[tuple[Any, Any, int, bool]]:
        """Scene (64, 64), end effector (4, 112, 112), action and success of one sample after the other."""
        for piece in self.pieces():
            maps = piece.scene[:, 0].numpy(), piece.end_effector.numpy()
            yield from zip(*maps, piece.action.tolist(), piece.success.tolist(), strict=True)


@dataclass(frozen=True)
class Peer:
    """A way to store and read the samples.

    Attributes
    ----------
    name : str
    group : str
        What the targets call it.
    files : str
        Folder of what it stores: peers that read the same files share it. Empty where it reads the release.
    packages : tuple of str
        What must be installed.
    write : callable
        Stores samples in a folder.
    open : callable
        Opens what was stored and gives the reader.
    """

    name: str
    group: str
    files: str
    packages: tuple[str, ...]
    write: Callable[[Path, Samples], None]
    open: Callable[[Path, Samples], Read]

    def missing(self) -> list[str]:
        """Packages that are not installed."""
        return [package for package in self.packages if find_spec(package) is None]


class _Blank(NamedTuple):
    """An empty batch as arrays, to be filled row by row, and as the tensors over them."""

    arrays: tuple[Any, Any, Any, Any]
    batch: Batch


def _blank(count: int) -> _Blank:
    arrays = (
        np.empty((count, *SCENE), np.float32),
        np.empty((count, *END_EFFECTOR), np.float32),
        np.empty(count, np.int64),
        np.empty(count, np.bool_),
    )
    return _Blank(arrays, Batch(*map(torch.from_numpy, arrays)))


# HDF5 in robomimic's layout


Demo = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], Sequence[int], Sequence[bool]]
"""Scene (T, 64, 64), end effector (T, 4, 112, 112), actions and successes of the T steps of an episode."""


def write_demos(path: Path, demos: Iterable[Demo], level: int = 4) -> None:
    """Write robomimic's layout, compressed: ``data/demo_i/obs/...``.

    The newest file format and chunks of one map, because both are smaller than h5py's defaults and read no slower.
    """
    import h5py

    with h5py.File(path, "w", libver="latest") as file:
        data = file.create_group("data")
        total = 0
        for number, (scene, end_effector, actions, successes) in enumerate(demos):
            demo = data.create_group(f"demo_{number}")
            steps = len(actions)
            demo.attrs["num_samples"] = steps
            demo["actions"] = np.array(actions, np.int64)[:, None]
            demo["rewards"] = np.array(successes, np.float64)
            demo["dones"] = np.arange(steps) == steps - 1
            for name, maps in (("scene", scene), ("end_effector", end_effector)):
                demo.create_dataset(
                    f"obs/{name}", data=maps, chunks=(1, *maps.shape[1:]), compression="gzip", compression_opts=level
                )
            total += steps
        data.attrs["total"] = total


def _write_hdf5(folder: Path, samples: Samples) -> None:
    demos = ((scene[None], ee[None], [action], [success]) for scene, ee, action, success in samples.each())
    write_demos(folder / "robomimic.hdf5", demos)


def _open_hdf5(folder: Path, samples: Samples) -> Read:
    import h5py

    file = h5py.File(folder / "robomimic.hdf5", "r", libver="latest")
    demos = [file[f"data/demo_{number}"] for number in range(len(samples.rows))]
    actions = np.array([demo["actions"][0, 0] for demo in demos])  # robomimic keeps what is not an image in memory too
    successes = np.array([demo["rewards"][0] > 0 for demo in demos])
    del demos

    def read(rows: Rows) -> Batch:
        (scene, end_effector, action, success), batch = _blank(len(rows))
        for place, row in enumerate(rows.tolist()):
            file[f"data/demo_{row}/obs/scene"].read_direct(scene, 0, place)
            file[f"data/demo_{row}/obs/end_effector"].read_direct(end_effector, 0, place)
        action[:], success[:] = actions[rows], successes[rows]
        return batch

    return read


# Minari


def _minari_writer(form: str) -> Callable[[Path, Samples], None]:
    def write(folder: Path, samples: Samples) -> None:
        os.environ["MINARI_DATASETS_PATH"] = str(folder)
        import gymnasium
        import minari
        from minari.data_collector import EpisodeBuffer

        space = gymnasium.spaces.Dict(
            {
                "scene": gymnasium.spaces.Box(-np.inf, np.inf, SCENE, np.float32),
                "end_effector": gymnasium.spaces.Box(-np.inf, np.inf, END_EFFECTOR, np.float32),
            }
        )
        dataset = None
        for piece in samples.pieces():
            planes = (("scene", piece.scene[:, 0].numpy()), ("end_effector", piece.end_effector.numpy()))
            buffers = [
                EpisodeBuffer(
                    # the format asks for an observation after the last action: nothing, which costs least to read
                    observations={name: np.stack([maps[row], np.zeros_like(maps[row])]) for name, maps in planes},
                    actions=np.array([int(piece.action[row])]),
                    rewards=[float(piece.success[row])],
                    terminations=[True],
                    truncations=[False],
                )
                for row in range(len(piece))
            ]
            if dataset is None:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", UserWarning)  # there is no environment and no author
                    dataset = minari.create_dataset_from_buffers(
                        "rema/read-v0",
                        buffers,
                        observation_space=space,
                        action_space=gymnasium.spaces.Discrete(2**16),
                        data_format=form,
                    )
            else:
                dataset.update_dataset_from_buffer(buffers)

    return write


def _open_minari(folder: Path, samples: Samples) -> Read:
    os.environ["MINARI_DATASETS_PATH"] = str(folder)
    import minari

    dataset = minari.load_dataset("rema/read-v0")

    def read(rows: Rows) -> Batch:
        (scene, end_effector, action, success), batch = _blank(len(rows))
        for place, episode in enumerate(dataset.iterate_episodes(rows.tolist())):
            scene[place] = episode.observations["scene"][0]
            end_effector[place] = episode.observations["end_effector"][0]
            action[place] = episode.actions[0]
            success[place] = episode.rewards[0] > 0
        return batch

    return read


# Hugging Face datasets, as LeRobot declares its features: arrays as Array2D and Array3D, images as PNG, in Parquet

_PNG = ("scene", "depth_1", "depth_2", "mask_1", "mask_2")


def _write_parquet(folder: Path, features: Any, rows: Iterator[dict[str, Any]]) -> None:
    import datasets

    datasets.disable_progress_bars()
    buffer: list[dict[str, Any]] = []
    number = 0

    def flush() -> None:
        columns = {name: [row[name] for row in buffer] for name in features}
        datasets.Dataset.from_dict(columns, features=features).to_parquet(folder / f"file-{number:03d}.parquet")

    for row in rows:
        buffer.append(row)
        if len(buffer) == PARQUET_ROWS:
            flush()
            buffer, number = [], number + 1
    if buffer:
        flush()


def _write_hf_arrays(folder: Path, samples: Samples) -> None:
    import datasets

    features = datasets.Features(
        scene=datasets.Array2D(SCENE, "float32"),
        end_effector=datasets.Array3D(END_EFFECTOR, "float32"),
        action=datasets.Value("int64"),
        success=datasets.Value("bool"),
    )
    _write_parquet(folder, features, (dict(zip(features, sample, strict=True)) for sample in samples.each()))


def _png(plane: npt.NDArray[Any]) -> dict[str, Any]:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(plane).save(buffer, "PNG")
    return {"bytes": buffer.getvalue(), "path": None}


def _write_hf_png(folder: Path, samples: Samples) -> None:
    import datasets

    def rows() -> Iterator[dict[str, Any]]:
        for scene, end_effector, action, success in samples.each():
            heights = (np.rint(plane / HEIGHT_STEP_M).astype(np.uint16) for plane in (scene, *end_effector[::2]))
            masks = (plane.astype(np.uint8) * 255 for plane in end_effector[1::2])
            images = dict(zip(_PNG, map(_png, (*heights, *masks)), strict=True))
            yield images | {"action": action, "success": success}

    features = {name: datasets.Image() for name in _PNG}
    labels = {"action": datasets.Value("int64"), "success": datasets.Value("bool")}
    _write_parquet(folder, datasets.Features(features | labels), rows())


def _open_hf(folder: Path) -> Any:
    import datasets

    datasets.disable_progress_bars()
    files = sorted(str(path) for path in folder.glob("*.parquet"))
    return datasets.Dataset.from_parquet(files, cache_dir=str(folder / CACHE))


def _open_hf_rows(folder: Path, samples: Samples) -> Read:
    dataset = _open_hf(folder).with_format("numpy")

    def read(rows: Rows) -> Batch:
        arrays, batch = _blank(len(rows))
        for place, row in enumerate(rows.tolist()):
            found = dataset[row]
            for array, name in zip(arrays, Batch._fields, strict=True):
                array[place] = found[name]
        return batch

    return read


def _open_hf_batches(folder: Path, samples: Samples) -> Read:
    dataset = _open_hf(folder).with_format("numpy")

    def read(rows: Rows) -> Batch:
        found = dataset[rows]
        return Batch(*(torch.from_numpy(np.asarray(found[name])) for name in Batch._fields))

    return read


def _open_hf_png(folder: Path, samples: Samples) -> Read:
    dataset = _open_hf(folder)
    step = np.float32(HEIGHT_STEP_M)

    def read(rows: Rows) -> Batch:
        (scene, end_effector, action, success), batch = _blank(len(rows))
        found = dataset[rows]
        for place in range(len(rows)):
            images = [np.asarray(found[name][place]) for name in _PNG]
            np.multiply(images[0].astype(np.uint16), step, out=scene[place])
            for state in (0, 1):
                np.multiply(images[1 + state].astype(np.uint16), step, out=end_effector[place, 2 * state])
                np.not_equal(images[3 + state], 0, out=end_effector[place, 2 * state + 1], casting="unsafe")
        action[:], success[:] = found["action"], found["success"]
        return batch

    return read


# LeRobot, which gives one frame after the other: its loader collates them


def _write_lerobot(folder: Path, samples: Samples) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    features = {
        "scene": {"dtype": "float32", "shape": SCENE, "names": None},
        "end_effector": {"dtype": "float32", "shape": END_EFFECTOR, "names": None},
        "action": {"dtype": "int64", "shape": (1,), "names": None},
        "success": {"dtype": "bool", "shape": (1,), "names": None},
    }
    dataset = LeRobotDataset.create("rema/read", fps=1, features=features, root=folder / "data", use_videos=False)
    for number, (scene, end_effector, action, success) in enumerate(samples.each(), 1):
        labels = {"action": np.array([action]), "success": np.array([success]), "task": "read"}
        dataset.add_frame({"scene": scene, "end_effector": end_effector, **labels})
        if number % EPISODE == 0 or number == len(samples.rows):  # where an episode ends makes no difference to a row
            dataset.save_episode()
    dataset.finalize()


def _open_lerobot(folder: Path, samples: Samples) -> Read:
    os.environ["HF_DATASETS_CACHE"] = str(folder / CACHE)
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("rema/read", root=folder / "data")

    def read(rows: Rows) -> Batch:
        arrays, batch = _blank(len(rows))
        for place, row in enumerate(rows.tolist()):
            found = dataset[row]
            for array, name in zip(arrays, Batch._fields, strict=True):
                array[place] = found[name].numpy()
        return batch

    return read


# zarr-python on the release itself


def _no_files(folder: Path, samples: Samples) -> None:
    """Reads the release."""


def _open_zarr(folder: Path, samples: Samples) -> Read:
    folder_of = {block.key: samples.release.folder.block(block).folder for block in samples.release.blocks}
    arrays = {
        key: {name: zarr.open_array(path / MAPS / name, mode="r") for name in ARRAYS} for key, path in folder_of.items()
    }
    steps = samples.steps
    block = [BlockKey(*key) for key in zip(steps["round"], steps["task"], steps["split"], strict=True)]
    scene_row, ee_row = steps["scene_row"].tolist(), steps["ee_row"].tolist()
    actions, successes = steps["action"].to_numpy(), steps["success"].to_numpy()

    def read(rows: Rows) -> Batch:
        (scene, end_effector, action, success), batch = _blank(len(rows))
        for place, row in enumerate(rows.tolist()):
            maps = arrays[block[row]]
            scene[place] = dequantise(np.asarray(maps["scene"][scene_row[row]]))
            end_effector[place, ::2] = dequantise(np.asarray(maps["ee_depth"][ee_row[row]]))
            end_effector[place, 1::2] = unpack_mask(np.asarray(maps["ee_mask"][ee_row[row]]))
        action[:], success[:] = actions[rows], successes[rows]
        return batch

    return read


HDF5, MINARI, DATASETS, LEROBOT, ZARR = "HDF5", "Minari", "datasets", "LeRobot", "zarr-python"
PEERS: Sequence[Peer] = (
    Peer("HDF5 gzip, robomimic's layout", HDF5, "hdf5", ("h5py",), _write_hdf5, _open_hdf5),
    Peer("Minari, HDF5 files", MINARI, "minari-hdf5", ("minari", "h5py"), _minari_writer("hdf5"), _open_minari),
    Peer("Minari, Arrow files", MINARI, "minari-arrow", ("minari",), _minari_writer("arrow"), _open_minari),
    Peer("datasets, arrays, row by row", DATASETS, "hf-arrays", ("datasets",), _write_hf_arrays, _open_hf_rows),
    Peer("datasets, arrays, by batch", DATASETS, "hf-arrays", ("datasets",), _write_hf_arrays, _open_hf_batches),
    Peer("datasets, 16-bit PNG, by batch", DATASETS, "hf-png", ("datasets", "PIL"), _write_hf_png, _open_hf_png),
    Peer("LeRobot, frame by frame", LEROBOT, "lerobot", ("lerobot",), _write_lerobot, _open_lerobot),
    Peer("zarr-python, row by row, our files", ZARR, "", ("zarr",), _no_files, _open_zarr),
)
"""The quicker of those that share a ``group`` stands for it."""
