"""The decoded cache: built once, whole or not there, and every byte of the release checked on the way."""

from __future__ import annotations

import json
import logging
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import rema_data
from rema_data.errors import IntegrityError, MissingFileError, StorageError
from rema_data.heights import decode_heights
from rema_data.loader import build
from rema_data.loader.cache import DecodedCache, caches_folder
from rema_data.loader.record import damaged_files, has_digests, is_whole
from rema_data.progress import Silent
from rema_data.release.folder import ReleaseFolder


def only_cache() -> Path:
    (path,) = [path for path in caches_folder().iterdir() if path.is_dir()]
    return path


def forbid_decoding(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("decoded again")

    monkeypatch.setattr(build, "decode_blocks", refuse)


def contents(cache: DecodedCache) -> list[bytes]:
    arrays = (cache.maps.scene, cache.maps.ee_depth, cache.maps.ee_mask, cache.index)
    return [np.asarray(array).tobytes() for array in arrays]


def test_holds_what_the_store_holds(release: rema_data.Release) -> None:
    cache, step, hand = release.cache, 0, 0
    for block in release.blocks:
        maps, rows = release.folder.block(block).maps(), slice(step, step + block.steps)
        assert np.array_equal(cache.maps.scene[rows], decode_heights(maps.read("scene", 0, block.steps)))
        stored = maps.read("ee_depth", 0, block.end_effectors)
        assert np.array_equal(cache.maps.ee_depth[hand : hand + block.end_effectors], decode_heights(stored))
        stored = maps.read("ee_mask", 0, block.end_effectors)
        assert np.array_equal(cache.maps.ee_mask[hand : hand + block.end_effectors], stored)
        assert np.array_equal(cache.index["scene_row"][rows], np.arange(rows.start, rows.stop))
        step, hand = rows.stop, hand + block.end_effectors
    assert len(cache.maps.scene) == len(cache.index) == step and len(cache.maps.ee_mask) == hand
    with pytest.raises(ValueError, match="read-only"):
        cache.maps.scene[0] = 0


def test_equal_gripper_maps_of_several_blocks_are_one(release: rema_data.Release) -> None:
    table, rows = release.steps(which="all").table, release.steps(which="all").rows
    assert len(set(rows.ee[table.embodiment == "gripper"].tolist())) == 1
    tools = rows.ee[table.embodiment != "gripper"].tolist()
    assert len(set(tools)) == len(tools)


def test_second_open_decodes_nothing(small: ReleaseFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    first = contents(rema_data.load(small.path).cache)
    forbid_decoding(monkeypatch)
    assert contents(rema_data.load(small.path).cache) == first
    assert only_cache().name.startswith(small.manifest.sha256[:16])


def test_ready_cache_opens_where_nothing_can_be_written(small: ReleaseFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    first = contents(rema_data.load(small.path).cache)
    for path in caches_folder().glob("*.lock"):
        path.unlink()
    monkeypatch.setattr(Path, "mkdir", lambda *_, **__: pytest.fail("a folder was made"))
    assert contents(rema_data.load(small.path).cache) == first
    assert not list(caches_folder().glob("*.lock"))


def overwrite(path: Path, offset: int, data: bytes) -> None:
    with path.open("rb+") as file:
        file.seek(offset)
        file.write(data)


def replace_in(path: Path, old: bytes, new: bytes) -> None:
    data = path.read_bytes()
    assert data.count(old, 0, 128) == 1 and len(old) == len(new)
    path.write_bytes(data.replace(old, new, 1))


DAMAGES: dict[str, Callable[[Path], object]] = {
    "truncated": lambda path: os.truncate(path / "scene.npy", 1000),
    "longer": lambda path: (path / "index.npy").write_bytes((path / "index.npy").read_bytes() + b"x"),
    "without its record": lambda path: (path / "cache.json").unlink(),
    "with half a record": lambda path: os.truncate(path / "cache.json", 40),
    "with another record": lambda path: (path / "cache.json").write_text("[]"),
    "without an array": lambda path: (path / "ee_mask.npy").unlink(),
    "of another version": lambda path: (path / "cache.json").write_text(
        json.dumps({**json.loads((path / "cache.json").read_text()), "version": 0})
    ),
    "with a header of other bytes": lambda path: overwrite(path / "scene.npy", 0, bytes(20)),
    "with a header of other words": lambda path: overwrite(path / "index.npy", 10, b"{'descr': [((("),
    "with a header of fewer rows": lambda path: replace_in(path / "ee_mask.npy", b"'shape': (", b"'shape':(0"),
    "with a header of another order": lambda path: replace_in(path / "scene.npy", b"False", b" True"),
    "with a header of another type": lambda path: replace_in(path / "scene.npy", b"<i2", b"<u2"),
    "empty": lambda path: [file.unlink() for file in path.iterdir()],
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
def test_damaged_cache_is_built_again(small: ReleaseFolder, damage: Callable[[Path], object]) -> None:
    first = contents(rema_data.load(small.path).cache)
    damage(only_cache())
    assert not is_whole(only_cache())
    assert contents(rema_data.load(small.path).cache) == first
    assert is_whole(only_cache())


def test_damaged_content_is_found_by_its_checksum(small: ReleaseFolder) -> None:
    rema_data.load(small.path).cache  # noqa: B018
    path = only_cache()
    assert has_digests(path) and damaged_files(path) == ()
    overwrite(path / "scene.npy", 5000, b"damage")
    assert is_whole(path)  # opening does not read it
    assert damaged_files(path) == ("scene.npy",)


def test_a_cache_of_an_earlier_rema_is_unknown_and_not_damaged(
    small: ReleaseFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = contents(rema_data.load(small.path).cache)
    record = json.loads((only_cache() / "cache.json").read_text())
    del record["digests"], record["content_sha256"]
    (only_cache() / "cache.json").write_text(json.dumps(record))
    assert is_whole(only_cache()) and not has_digests(only_cache()) and damaged_files(only_cache()) == ()
    forbid_decoding(monkeypatch)
    assert contents(rema_data.load(small.path).cache) == first


def test_cache_removed_while_in_use_is_named(small: ReleaseFolder) -> None:
    dataset = rema_data.load(small.path).steps()
    shutil.rmtree(only_cache())
    with pytest.raises(MissingFileError, match="load the release again"):
        dataset[0]


def test_leftovers_of_a_killed_builder_go(small: ReleaseFolder) -> None:
    rema_data.load(small.path).cache  # noqa: B018
    name = only_cache().name
    shutil.rmtree(only_cache())
    left = caches_folder() / f".{name}.abcdef"
    left.mkdir()
    (left / "scene.npy").write_bytes(b"half")
    rema_data.load(small.path).cache  # noqa: B018
    assert sorted(path.name for path in caches_folder().iterdir()) == [name, f"{name}.lock"]


DIE = """
import os, sys
import rema_data
from rema_data.loader import build
write, left = build._FileSink.put, [int(sys.argv[2])]
def put(*words):
    write(*words)
    left[0] -= 1
    if left[0] < 0:
        os._exit(9)
build._FileSink.put = put
rema_data.load(sys.argv[1]).cache
"""


def test_killed_while_decoding(small: ReleaseFolder) -> None:
    died = subprocess.run([sys.executable, "-c", DIE, str(small.path), "3"], check=False)
    assert died.returncode == 9
    (left,) = [path for path in caches_folder().iterdir() if path.is_dir()]
    assert left.name.startswith(".") and not is_whole(left)
    assert contents(rema_data.load(small.path).cache) == contents(rema_data.load(small.path, cache="memory").cache)
    assert not left.exists()


@pytest.mark.parametrize("cache", [None, "memory"])
@pytest.mark.parametrize("which", ["steps.parquet", "maps.zarr/scene/c/0/0/0", "maps.zarr/ee_depth/zarr.json"])
def test_flipped_bit_is_found(small: ReleaseFolder, which: str, cache: str | None) -> None:
    path = small.path / "round-1" / "push" / "train" / which
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(IntegrityError, match="is not the one that was sealed") as caught:
        rema_data.load(small.path, cache=cache).steps()
    assert str(path) in caught.value.message and "rema download" not in caught.value.hint
    assert "copy it again" in caught.value.hint and f"rema verify {small.path}" in caught.value.hint
    assert not caches_folder().exists() or not [path for path in caches_folder().iterdir() if path.is_dir()]


def test_file_that_goes_meanwhile(small: ReleaseFolder) -> None:
    opened = rema_data.load(small.path)
    assert len(opened.blocks) == 4
    path = small.path / "round-1" / "push" / "val" / "steps.parquet"
    path.unlink()
    with pytest.raises(MissingFileError, match=f"rema verify {small.path}") as caught:
        opened.cache  # noqa: B018
    assert str(path) in str(caught.value)


def test_full_disk(small: ReleaseFolder) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, hard))
    try:
        with pytest.raises(StorageError, match="larger than is allowed") as caught:
            rema_data.load(small.path).cache  # noqa: B018
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert "REMA_HOME" in caught.value.hint and "cache='memory'" in caught.value.hint
    assert not [path for path in caches_folder().iterdir() if path.is_dir()]
    assert len(rema_data.load(small.path, cache="memory").steps()) > 0


def test_too_little_space_is_said_before_decoding(small: ReleaseFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    forbid_decoding(monkeypatch)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10**9, 10**9, 1000))  # type: ignore[attr-defined]
    with pytest.raises(StorageError, match=r"needs \d+ MB, 0 MB are free") as caught:
        rema_data.load(small.path).cache  # noqa: B018
    assert "REMA_HOME" in caught.value.hint


def test_home_that_cannot_be_a_folder(small: ReleaseFolder, places: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (places / "file").touch()
    monkeypatch.setenv("REMA_HOME", str(places / "file"))
    opened = rema_data.load(small.path)
    with pytest.raises(StorageError, match="REMA_HOME"):
        opened.cache  # noqa: B018
    elsewhere = rema_data.load(small.path, cache=places / "elsewhere")
    assert contents(elsewhere.cache) == contents(rema_data.load(small.path, cache="memory").cache)
    assert elsewhere.cache.folder is not None and elsewhere.cache.folder.parent == places / "elsewhere"


def test_progress_and_log(small: ReleaseFolder, caplog: pytest.LogCaptureFixture) -> None:
    class Seen(Silent):
        def phase(self, name: str, total: int) -> None:
            phases.append((name, total))

        def advance(self, n: int) -> None:
            steps.append(n)

    phases: list[tuple[str, int]] = []
    steps: list[int] = []
    with caplog.at_level(logging.INFO, "rema_data"):
        rema_data.load(small.path, progress=Seen()).cache  # noqa: B018
    assert phases == [("decode tiny", sum(steps))] and min(steps) > 0
    assert [record.message.split()[0] for record in caplog.records if "tiny" in record.message] == [
        "decoding",
        "decoded",
    ]


BUILD = """
import logging, sys
logging.basicConfig(level=logging.INFO, stream=sys.stdout)
import rema_data
cache = rema_data.load(sys.argv[1]).cache
print("sum", int(cache.maps.scene.sum()), len(cache.index))
"""


def test_processes_that_open_at_once_decode_once(small: ReleaseFolder) -> None:
    words = [sys.executable, "-c", BUILD, str(small.path)]
    runs = [subprocess.Popen(words, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    outputs = [run.communicate()[0] for run in runs]
    assert [run.returncode for run in runs] == [0, 0]
    assert len({output.splitlines()[-1] for output in outputs}) == 1
    assert sum("decoded tiny" in output for output in outputs) == 1
