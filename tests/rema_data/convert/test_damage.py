"""Files that are no export, or not a whole one, are refused in a sentence that says which and why."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from rema_data.convert import export_release, import_release
from rema_data.errors import InputError, IntegrityError, MissingFileError, RemaError
from rema_data.schema import SCHEMA_VERSION
from rema_data.testing import make_release

TASK = "grasp_grasp_push"
BLOCK = f"rema/round-1/{TASK}/train"


def refuse(sources: list[Path], tmp_path: Path, kind: type[RemaError], words: str) -> RemaError:
    """The error of an import, which leaves nothing behind."""
    with pytest.raises(kind, match=words) as caught:
        import_release(sources, tmp_path / "back")
    assert caught.value.hint
    assert not (tmp_path / "back").exists() or list((tmp_path / "back").iterdir()) == []
    return caught.value


def test_files_that_are_not_there(tmp_path: Path) -> None:
    refuse([tmp_path / "no.hdf5"], tmp_path, MissingFileError, "there is no file .*no.hdf5")
    refuse([tmp_path], tmp_path, MissingFileError, "it has no HDF5 file, and no")
    refuse([], tmp_path, MissingFileError, "no file to import was named")


def test_a_file_of_somebody_else(tmp_path: Path) -> None:
    path = tmp_path / "demo.hdf5"
    with h5py.File(path, "w") as file:
        file.create_group("data/demo_0").attrs["num_samples"] = 3
    error = refuse([path], tmp_path, InputError, "demo.hdf5 was not written by `rema export`")
    assert "rema collect" in error.hint


def unknown(name: str) -> Callable[[h5py.File], None]:
    return lambda file: file["rema"].attrs.create(name, 99)


def without(name: str) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[name]

    return change


def attribute(name: str, value: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file["data/demo_4"].attrs[name]
        if value is not None:
            file["data/demo_4"].attrs[name] = value

    return change


def replaced(name: str, array: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = array

    return change


def scene(value: float) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file["data/demo_4/obs/scene"][0, 1, 2] = value

    return change


def halved(file: h5py.File) -> None:
    file["data/demo_4/obs/end_effector"][0, 1, 2, 1] = 0.5


def twice(file: h5py.File) -> None:
    file.copy("data/demo_4", "data/demo_40")


CHANGES: list[tuple[Callable[[h5py.File], None], type[RemaError], str]] = [
    (unknown("format_version"), InputError, "format version 99, this rema reads 1"),
    (unknown("schema_version"), InputError, f"schema version 99, this rema reads {SCHEMA_VERSION}"),
    (unknown("maps"), IntegrityError, "its maps are 99, which is not known"),
    (without("data"), IntegrityError, "a part of it is missing"),
    (without("rema/manifest"), IntegrityError, "a part of it is missing"),
    (replaced("rema/manifest", np.zeros(9, np.uint8)), IntegrityError, f"manifest inside .*{TASK}.hdf5 cannot be used"),
    (without(BLOCK), IntegrityError, "data/demo_0 says that it belongs to round-1/.*which is not in the file"),
    (without(f"{BLOCK}/arm"), IntegrityError, "a part of it is missing.*arm"),
    (replaced(f"{BLOCK}/action", np.zeros(3)), IntegrityError, "column action cannot be used: it holds float64"),
    (replaced(f"{BLOCK}/action", np.zeros(3, np.uint16)), IntegrityError, "truncated or damaged"),
    (without("data/demo_4/obs/scene"), IntegrityError, "a part of it is missing.*scene"),
    (replaced("data/demo_4/obs/scene", np.zeros((1, 64, 64))), IntegrityError, "data/demo_4 .*obs/scene holds float64"),
    (scene(np.nan), IntegrityError, "data/demo_4 has a map that cannot be stored: a height"),
    (halved, IntegrityError, "data/demo_4 has a map that cannot be stored: a mask"),
    (twice, IntegrityError, "data/demo_40 is the same episode as demo_4"),
    (attribute("seed", None), IntegrityError, "data/demo_4 has no attribute seed"),
    (attribute("seed", 1.5), IntegrityError, "data/demo_4 has the seed .*, which is not uint64"),
    (attribute("split", np.int64(3)), IntegrityError, "data/demo_4 has the split"),
    (attribute("round", np.int16(7)), IntegrityError, "data/demo_4 says that it belongs to round-7"),
    (attribute("num_samples", 9), IntegrityError, "data/demo_4 has 9 samples"),
    (attribute("first_step", np.int32(-1)), IntegrityError, "data/demo_4 does not begin at its first_step"),
    (attribute("first_step", np.int32(9999)), IntegrityError, "data/demo_4 does not begin at its first_step"),
    (attribute("first_step", np.int32(0)), IntegrityError, "data/demo_4 does not begin at its first_step"),
    (attribute("episode", np.int32(77)), IntegrityError, "data/demo_4 does not begin at its first_step"),
]


@pytest.mark.parametrize("number", range(len(CHANGES)))
def test_a_file_that_contradicts_itself(number: int, export: Path, tmp_path: Path) -> None:
    change, kind, words = CHANGES[number]
    path = export / f"{TASK}.hdf5"
    with h5py.File(path, "r+") as file:
        change(file)
    refuse([path], tmp_path, kind, words)


def test_a_file_without_episodes(export: Path, tmp_path: Path) -> None:
    path = export / "grasp.hdf5"
    with h5py.File(path, "r+") as file:
        for name in list(file["data"]):
            del file[f"data/{name}"]
    refuse([path], tmp_path, InputError, "no episode of a release")


def test_files_of_two_releases_are_not_mixed(export: Path, tmp_path: Path) -> None:
    other = make_release(tmp_path / "data", "other", tasks=("push",), episodes=5)
    export_release(other, export)
    refuse([export], tmp_path, InputError, "grasp.hdf5 belongs to the release tiny .*, .* to other")


def test_a_file_named_twice_is_refused(export: Path, tmp_path: Path) -> None:
    refuse([export / "grasp.hdf5", export], tmp_path, InputError, "both hold round-1/grasp/train")
