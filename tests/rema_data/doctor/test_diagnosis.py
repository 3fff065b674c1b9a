"""Versions, reading speed, and what the doctor makes of all it saw."""

from __future__ import annotations

import dataclasses
import json
import shutil
import sys
from importlib import metadata
from pathlib import Path

import pytest

from rema_data.doctor import diagnose, diagnosis
from rema_data.doctor.machine import Speed, package_versions
from rema_data.release.folder import ReleaseFolder
from rema_data.release.registry import load_published, register
from rema_data.testing import make_release
from tests.rema_data.verify.damage import flip

BULLET = "pybullet" if sys.version_info < (3, 12) else "pybullet-arm64"


def test_versions_against_the_ranges_of_the_package() -> None:
    found = {item.name: item for item in package_versions()}
    assert {"python", "rema", "numpy", "zarr", "torch", "pyarrow", BULLET} <= set(found)
    assert "matplotlib" not in found  # of an extra
    assert all(item.ok for item in found.values())
    assert found[BULLET].wanted == f"=={metadata.version(BULLET)}"
    assert found["numpy"].version == metadata.version("numpy")


def test_versions_out_of_range(monkeypatch: pytest.MonkeyPatch) -> None:
    real = metadata.version

    def version(name: str) -> str:
        if name == "zarr":
            raise metadata.PackageNotFoundError(name)
        return "3.2.6" if name == BULLET else real(name)

    monkeypatch.setattr(metadata, "version", version)
    found = {item.name: item for item in package_versions()}
    assert (found["zarr"].version, found["zarr"].ok) == (None, False)
    assert not found[BULLET].ok and found["numpy"].ok


def test_a_machine_in_order(machine: Path) -> None:
    found = diagnose(0.01)
    assert found.problems == []
    assert found.tested == "tiny"
    assert [(speed.delivery, speed.batch_size) for speed in found.speeds] == [
        ("quantised", 8),
        ("quantised", 256),
        ("float32", 8),
        ("float32", 256),
    ]
    assert all(speed.samples_per_s > 0 for speed in found.speeds)
    assert [item.state for item in found.disposable] == ["ready"]
    printed = json.loads(json.dumps(found.to_dict()))
    assert printed["ok"] and printed["releases"][0]["name"] == "tiny"


def test_nothing_is_read_or_written_when_that_is_not_wanted(machine: Path) -> None:
    found = diagnose(0)
    assert found.speeds == [] and found.tested == ""
    assert not (machine / "home" / "decoded").exists()


def test_the_newest_published_release_is_read(machine: Path) -> None:
    other = make_release(machine / "home" / "releases", "newer", tasks=("grasp",), episodes=3)
    make_release(machine / "home" / "releases", "another", tasks=("grasp",), episodes=3)
    assert diagnose(0.01).tested == "tiny"
    register(other.manifest)
    assert diagnose(0.01).tested == "newer"


def test_an_empty_machine(machine: Path) -> None:
    shutil.rmtree(machine / "home")
    found = diagnose(0.01)
    assert found.problems == []
    assert found.advice == ["no release is on this machine: rema download"]


def test_a_damaged_release_is_a_problem(machine: Path) -> None:
    shard = machine / "home" / "releases" / "tiny" / "round-1" / "push" / "val" / "maps.zarr" / "scene" / "c/0/0/0"
    shard.chmod(0o644)
    flip(shard, 20)
    (problem,) = diagnose(0.01).problems
    assert problem.startswith("tiny cannot be read") and str(shard) in problem


def test_another_release_under_a_published_name_is_a_problem(machine: Path, tmp_path: Path) -> None:
    other: ReleaseFolder = make_release(machine / "releases", tasks=("grasp",), episodes=3)
    (problem,) = diagnose(0).problems
    assert problem.startswith(f"{other.path}: not the published one")


def test_advice(machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    slow = [Speed("quantised", 8, 9e4), Speed("float32", 8, 1e3)]
    monkeypatch.setattr(diagnosis, "measure_speed", lambda release, seconds: slow)
    monkeypatch.setattr(diagnosis, "home", lambda: diagnosis.Home("/full", False, 10))
    (machine / "home" / "releases" / "tiny" / "x.part").touch()
    (machine / "home" / "decoded" / ("0" * 16 + "-" + "0" * 8)).mkdir(parents=True)
    (machine / "home" / "decoded" / ("0" * 16 + "-" + "0" * 8) / "scene.npy").write_bytes(bytes(3_000_000))
    found = diagnose(0.01)
    assert found.problems == ["/full cannot be written: set REMA_HOME to another folder"]
    text = "\n".join(found.advice)
    for words in (
        "the decoded cache of tiny needs",
        "a download of tiny is not finished: rema download tiny",
        "3 MB of decoded caches are of no use any more: rema doctor --prune",
        "float32 batches come slower than 2,400 samples a second",
    ):
        assert words in text
    slow[0] = Speed("quantised", 8, 100.0)
    text = "\n".join(diagnose(0.01).advice)
    assert "set REMA_HOME to a local disk" in text and "float32 batches" not in text


def test_a_part_of_a_round_is_fetched_with_the_release_that_has_it(
    machine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder of releases may hold rounds that are not published by themselves."""
    tiny = load_published("tiny")
    files = tuple(dataclasses.replace(file, holder="tiny-round-1") for file in tiny.files)
    monkeypatch.setattr(diagnosis, "load_published", lambda name: dataclasses.replace(tiny, files=files))
    (machine / "home" / "releases" / "tiny-round-1").mkdir()
    (machine / "home" / "releases" / "tiny-round-1" / "x.part").touch()
    assert "a download of tiny is not finished: rema download tiny" in diagnose(0).advice
