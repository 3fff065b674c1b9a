"""The benchmarks of reading, of size and of codecs, each in a reduced size."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest

from rema_data.testing import make_release
from tests.benchmarks.test_benchmarks import measured, page


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> str:
    made = make_release(tmp_path_factory.mktemp("releases"), "small", ("grasp", "grasp_push"), episodes=20)
    return str(made.path)


@pytest.mark.benchmark
def test_reading_against_others(tmp_path: Path, release: str) -> None:
    """The script stops where a reader delivers other values than the loader."""
    words = (
        "--release",
        release,
        "--steps",
        "20",
        "--samples",
        "16",
        "--repeats",
        "1",
        "--seconds",
        "0",
        "--batches",
        "8,16",
    )
    content = measured(tmp_path, "read", *words, "--peers", "HDF5,Minari,zarr-python")
    numbers = content["numbers"]
    assert numbers["steps"] == 20
    for speeds in numbers["samples_per_second"].values():
        assert all(speed > 0 for speed in speeds.values())
        assert {"numpy.take, quantised", "ours, quantised", "ours, float32"} < set(speeds)
        assert "HDF5 gzip, robomimic's layout" in speeds
    if find_spec("minari") is None:
        assert numbers["absent"]["Minari, HDF5 files"] == "not installed: minari"
        assert any("minari" in note and "pip install" in note for note in content["notes"])
        verdicts = [row for row in content["targets"] if row["what"].endswith("Minari")]
        assert verdicts
        assert not any(row["reached"] for row in verdicts)
    text = page(tmp_path)
    assert "## Training reads" in text
    assert "bare gripper" in text


@pytest.mark.slow
@pytest.mark.skipif(
    any(find_spec(name) is None for name in ("minari", "datasets", "lerobot")), reason="needs minari and LeRobot"
)
def test_all_readers_deliver_the_same(tmp_path: Path, release: str) -> None:
    words = (
        "--release",
        release,
        "--steps",
        "20",
        "--samples",
        "16",
        "--repeats",
        "1",
        "--seconds",
        "0",
        "--batches",
        "8,16",
    )
    assert measured(tmp_path, "read", *words)["numbers"]["absent"] == {}


@pytest.mark.benchmark
def test_size(tmp_path: Path, release: str) -> None:
    content = measured(tmp_path, "size", "--release", release)
    tasks = content["numbers"]["tasks"]
    assert set(tasks) == {"grasp", "grasp_push", "all"}
    for sizes in tasks.values():
        assert (
            0
            < sizes["maps"]
            < sizes["HDF5 gzip 9"]
            < sizes["HDF5 gzip 4"]
            < content["numbers"]["raw_bytes_a_step"] * 48
        )
        assert sizes["labels"] < sizes["tables"]
    assert tasks["all"]["npz"] == tasks["grasp"]["npz"] + tasks["grasp_push"]["npz"]
    assert "## Size of a release" in page(tmp_path)


def test_codecs_of_a_release(tmp_path: Path, release: str) -> None:
    words = ("--release", release, "--arrays", "ee_depth", "--shuffles", "none,bitshuffle", "--levels", "3,19")
    settings = measured(tmp_path, "codecs", *words, "--chunks", "16,32", "--repeats", "1")["numbers"]["settings"]
    assert {(row["codec"], row["level"]) for row in settings} == {
        ("zstd", 3),
        ("zstd", 19),
        ("blosc-zstd bitshuffle", 3),
    }
    assert all(0 < row["bytes_per_row"] < 50176 and row["decode_mb_per_s"] > 0 for row in settings)
    assert "## Codecs of the maps" in page(tmp_path)


def test_codecs_of_observed_maps(tmp_path: Path) -> None:
    words = ("--tasks", "grasp_push", "--episodes", "2", "--shuffles", "none", "--levels", "3", "--chunks", "16")
    settings = measured(tmp_path, "codecs", *words, "--repeats", "1")["numbers"]["settings"]
    assert {row["array"]: row["rows"] for row in settings} == {"scene": 4, "ee_depth": 3, "ee_mask": 3}
