"""An export from a stranger reads no other file of the user, and takes no more memory than its size allows."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from rema_data.convert import import_release
from rema_data.errors import IntegrityError
from tests.memory import little_memory
from tests.rema_data.convert.test_damage import refuse

TASK = "grasp"
COLUMNS = f"rema/round-1/{TASK}/train"
SCENE, HAND = "data/demo_0/obs/scene", "data/demo_0/obs/end_effector"
SECRET = b"the user's own words ..."


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """A file of the user: long enough to be any map."""
    path = tmp_path / "secret.bin"
    path.write_bytes((SECRET * 20_000)[: 4 * 112 * 112 * 4 * 2])
    return path


@pytest.fixture
def other(tmp_path: Path) -> Path:
    """An HDF5 file of the user."""
    path = tmp_path / "secret.hdf5"
    with h5py.File(path, "w") as file:
        file["scene"] = np.full((1, 64, 64, 1), 0.25, np.float32)
        file.create_group("demo").attrs["num_samples"] = 1
    return path


def external_storage(name: str) -> Callable[[h5py.File, Path, Path], None]:
    def change(file: h5py.File, secret: Path, other: Path) -> None:
        shape, kind, notes = file[name].shape, file[name].dtype, dict(file[name].attrs)
        del file[name]
        size = int(np.prod(shape)) * kind.itemsize
        file.create_dataset(name, shape, kind, external=[(str(secret), 0, size)]).attrs.update(notes)

    return change


def virtual(name: str) -> Callable[[h5py.File, Path, Path], None]:
    def change(file: h5py.File, secret: Path, other: Path) -> None:
        shape, kind = file[name].shape, file[name].dtype
        del file[name]
        layout = h5py.VirtualLayout(shape, kind)
        layout[:] = h5py.VirtualSource(str(other), "scene", (1, 64, 64, 1))[(slice(None),) * 4]
        file.create_virtual_dataset(name, layout)

    return change


def link(name: str, to: Any) -> Callable[[h5py.File, Path, Path], None]:
    def change(file: h5py.File, secret: Path, other: Path) -> None:
        del file[name]
        file[name] = h5py.ExternalLink(str(other), "scene") if to is None else h5py.SoftLink(to)

    return change


OUTSIDE = {
    "external storage of a map": (external_storage(HAND), r"secret\.bin.*reads no other file"),
    "external storage of a column": (external_storage(f"{COLUMNS}/x_m"), r"secret\.bin.*reads no other file"),
    "external storage of the manifest": (external_storage("rema/manifest"), r"secret\.bin.*reads no other file"),
    "external storage of the card": (external_storage("rema/card/0"), r"secret\.bin.*reads no other file"),
    "external storage of an action": (external_storage("data/demo_0/actions"), r"secret\.bin.*reads no other file"),
    "virtual map": (virtual(SCENE), "virtual dataset"),
    "external link to a map": (link(SCENE, None), r"link to the file '.*secret\.hdf5'"),
    "external link to a demo": (link("data/demo_0", None), r"link to the file '.*secret\.hdf5'"),
    "external link to all demos": (link("data", None), r"link to the file '.*secret\.hdf5'"),
    "external link to the columns": (link(COLUMNS, None), r"link to the file '.*secret\.hdf5'"),
    "external link to the header": (link("rema", None), r"link to the file '.*secret\.hdf5'"),
    "external link to the card": (link("rema/card/0", None), r"link to the file '.*secret\.hdf5'"),
    "soft link to a map": (link(SCENE, "/data/demo_1/obs/scene"), "link to '/data/demo_1/obs/scene'"),
    "soft link to nowhere": (link("data/demo_0", "/nowhere"), "link to '/nowhere'"),
}


@pytest.mark.parametrize("case", OUTSIDE)
def test_nothing_outside_of_the_file_is_read(
    case: str, export: Path, secret: Path, other: Path, tmp_path: Path
) -> None:
    change, words = OUTSIDE[case]
    path = export / f"{TASK}.hdf5"
    with h5py.File(path, "r+") as file:
        change(file, secret, other)
    refuse([path], tmp_path, IntegrityError, words)
    for made in (tmp_path / "back").rglob("*"):
        assert not made.is_file() or SECRET not in made.read_bytes()


def unstored(name: str, shape: tuple[int, ...], **options: Any) -> Callable[[h5py.File], None]:
    """An array of which nothing is stored: it reads as zeros."""

    def change(file: h5py.File) -> None:
        kind, notes = file[name].dtype, dict(file[name].attrs)
        del file[name]
        file.create_dataset(name, shape, kind, **options).attrs.update(notes)

    return change


def episode_of(steps: int) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        demo = file["data/demo_0"]
        demo.attrs["num_samples"] = steps
        demo.attrs["steps"] = np.int8(steps)

    return change


def texts(file: h5py.File) -> None:
    del file[f"{COLUMNS}/policy"]
    file.create_dataset(f"{COLUMNS}/policy", (2**30,), h5py.string_dtype(), chunks=(1024,))


def wide_text(file: h5py.File) -> None:
    count = len(file[f"{COLUMNS}/policy"])
    del file[f"{COLUMNS}/policy"]
    file.create_dataset(f"{COLUMNS}/policy", (count,), "S1000000000", chunks=(1,))


def long_attribute(file: h5py.File) -> None:
    file["data/demo_0"].attrs.create("note", np.zeros(10_000_000, np.uint8))


BOMBS: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    "column": (unstored(f"{COLUMNS}/x_m", (2**31,), chunks=(2**16,)), "17,179,869,184 bytes in memory"),
    "manifest": (unstored("rema/manifest", (2**34,), chunks=(2**20,)), "17,179,869,184 bytes in memory"),
    "card": (unstored("rema/card/0", (2**34,), chunks=(2**20,)), "17,179,869,184 bytes in memory"),
    "chunk": (unstored(SCENE, (1, 64, 64, 1), chunks=(2**18, 64, 64, 1), maxshape=(None, 64, 64, 1)), "has chunks of"),
    "map": (unstored(SCENE, (2**20, 64, 64, 1), chunks=(1, 64, 64, 1)), "bytes in memory"),
    "rewards": (unstored("data/demo_0/rewards", (2**32,), chunks=(2**16,)), "bytes in memory"),
    "texts": (texts, "variable length"),
    "wide text": (wide_text, "bytes in memory"),
    "episode of 100 steps": (episode_of(100), "has 100 samples, and 100 steps"),
    "attribute": (long_attribute, "an attribute of 10,000,000 bytes"),
}


@pytest.mark.parametrize("case", BOMBS)
def test_a_small_file_takes_little_memory(case: str, export: Path, tmp_path: Path) -> None:
    change, words = BOMBS[case]
    path = export / f"{TASK}.hdf5"
    with h5py.File(path, "r+") as file:
        change(file)
    assert path.stat().st_size < 20_000_000
    with little_memory():
        refuse([path], tmp_path, IntegrityError, words)


def test_hard_links_are_parts_of_the_file(export: Path, tmp_path: Path) -> None:
    """What a tool that packs equal arrays once leaves: it is imported as it was."""
    path = export / f"{TASK}.hdf5"
    with h5py.File(path, "r+") as file:
        file["again"] = file[SCENE]
        del file[SCENE]
        file[SCENE] = file["again"]
    assert import_release([path], tmp_path / "back").release.manifest.blocks[0].task == TASK


def test_a_file_is_looked_through_part_by_part(tmp_path: Path) -> None:
    """Its many parts take longer together than any part may; more parts than it has room for would be a circle."""
    with h5py.File(tmp_path / "parts.hdf5", "w", libver="v110") as file:
        for number in range(10_000):
            file.create_group(str(number))
    look = "from pathlib import Path; from rema_data.convert import hdf5_probe as p; {}; p._main(Path({!r}))"
    for change, whole in (("p._SECONDS = 2", True), ("p._PART_BYTES = 1 << 10", False)):
        command = [sys.executable, "-c", look.format(change, str(tmp_path / "parts.hdf5"))]
        assert (subprocess.run(command, check=False, capture_output=True).returncode == 0) == whole
