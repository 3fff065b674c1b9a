"""Formats of sealed folders: what is not whole or not ours is refused in a sentence that says which file and why."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rema_data.convert import export_release, find_format, import_release
from rema_data.convert.folders import FolderFormat, NewDataset
from rema_data.convert.pieces import Piece
from rema_data.convert.tfrecord import byte_lists, read_records
from rema_data.errors import InputError, IntegrityError, MissingFileError, RemaError, RunMismatchError, StorageError
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import BlockEntry
from rema_data.testing import make_release
from tests.rema_data.convert.conftest import files
from tests.rema_data.convert.test_formats import BUILT_IN

FOLDERS = [name for name in BUILT_IN if isinstance(find_format(name), FolderFormat)]


@pytest.fixture(scope="session")
def exports(release: ReleaseFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("folders")
    for name in FOLDERS:
        export_release(release, folder / name, name, tasks=["grasp"])
    return folder


@pytest.fixture(params=FOLDERS)
def dataset(request: pytest.FixtureRequest, exports: Path, tmp_path: Path) -> Path:
    """A dataset that may be damaged; its parent is the export, and the parent's name the format."""
    (folder,) = shutil.copytree(exports / request.param, tmp_path / request.param).iterdir()
    return folder


def refuse(source: Path, kind: type[RemaError], words: str, format: str | None = None) -> RemaError:
    target = source.parent / "back"
    with pytest.raises(kind, match=words) as caught:
        import_release([source], target, "part", format)
    assert caught.value.hint
    assert not target.exists() or list(target.iterdir()) == []
    return caught.value


@pytest.mark.parametrize("name", FOLDERS)
@pytest.mark.parametrize("array", ["scene", "ee_depth", "ee_mask"])
def test_a_map_that_was_not_written_as_it_is_leaves_no_export(
    name: str, array: str, release: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One bit of the last map of a block."""
    pieces = NewDataset.pieces

    def bent(self: NewDataset, block: BlockEntry) -> Iterator[Piece]:
        *first, last = pieces(self, block)
        changed = getattr(last.maps, array).copy()
        changed[-1].flat[-1] ^= 1
        yield from (*first, last._replace(maps=replace(last.maps, **{array: changed})))

    monkeypatch.setattr(NewDataset, "pieces", bent)
    with pytest.raises(StorageError, match=r"the maps of round-1/grasp/train") as caught:
        export_release(release, tmp_path, name, tasks=["grasp"])
    assert "run the same command again" in caught.value.hint
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", FOLDERS)
def test_a_file_that_was_not_written_whole_leaves_no_export(
    name: str, release: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind = type(find_format(name))
    write = kind.write

    def cut(self: FolderFormat, dataset: NewDataset) -> None:
        write(self, dataset)
        data = [path for path in dataset.folder.rglob("*.*") if path.suffix != ".json" and "meta" not in path.parts]
        largest = max(data, key=lambda path: path.stat().st_size)
        os.truncate(largest, largest.stat().st_size - 5)

    monkeypatch.setattr(kind, "write", cut)
    with pytest.raises(StorageError, match="was not written"):
        export_release(release, tmp_path, name, tasks=["grasp"], split="train")
    assert list(tmp_path.iterdir()) == []


def test_a_table_that_was_not_copied_as_it_is_leaves_no_export(
    release: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def half(source: Path, target: Path) -> None:
        target.write_bytes(source.read_bytes()[:-1])

    monkeypatch.setattr(shutil, "copyfile", half)
    with pytest.raises(StorageError, match=r"episodes.parquet of round-1/grasp/train"):
        export_release(release, tmp_path, "hf", tasks=["grasp"])
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_goes_while_it_is_read_is_named(
    release: ReleaseFolder, exports: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And not the export, or the release, that is written meanwhile."""
    gone = tmp_path / "gone"

    def read(*_: Any) -> Any:
        return gone.read_bytes()

    with monkeypatch.context() as patch:
        patch.setattr(NewDataset, "pieces", read)
        with pytest.raises(MissingFileError, match=f"does not exist: {gone}"):
            export_release(release, tmp_path, "rlds", tasks=["grasp"])
    monkeypatch.setattr("rema_data.convert.inbound._write_blocks", read)
    with pytest.raises(MissingFileError, match=f"does not exist: {gone}"):
        import_release([exports / "rlds"], tmp_path, "part")
    assert list(tmp_path.iterdir()) == []


def test_there_are_formats_of_folders() -> None:
    assert FOLDERS == ["hf", "lerobot", "minari", "rlds"]


def test_rlds_has_the_facts_of_every_episode(exports: Path, release: ReleaseFolder) -> None:
    """Null is an empty text; a root seed of 0, which is that of this release, is none."""
    names = ("split", "seed", "failure")
    (block,) = [entry for entry in release.manifest.blocks if entry.key.path == "round-1/grasp/train"]
    rows = release.block(block).episodes().to_pylist()
    assert {row["seed"] for row in rows} == {0} and {row["failure"] is None for row in rows} == {True, False}
    (path,) = (exports / "rlds").rglob("*-train.tfrecord-*")
    with path.open("rb") as file:
        found = [
            byte_lists(record, [f"episode_metadata/{name}" for name in names]) for record in read_records(file, 1 << 24)
        ]
    texts = [tuple(lists[f"episode_metadata/{name}"][0].decode() for name in names) for lists in found]
    assert texts == [("train", "0", row["failure"] or "") for row in rows]


def test_the_format_need_not_be_named(dataset: Path, release: ReleaseFolder, tmp_path: Path) -> None:
    imported = import_release([dataset.parent], tmp_path / "back", "part")
    block = "round-1/grasp/train"
    assert files(imported.release.path / block) == files(release.path / block)


def test_a_data_set_may_be_named_itself(dataset: Path, tmp_path: Path) -> None:
    imported = import_release([dataset], tmp_path / "back", "part")
    assert len(imported.release.manifest.blocks) == 2


def test_another_format_is_named(dataset: Path) -> None:
    name = dataset.parent.name
    other = next(format for format in FOLDERS if format != name)
    error = refuse(dataset.parent, InputError, f"is an export in the format {name}, not {other}", other)
    assert f"--format {name}" in error.hint


def test_a_data_set_of_somebody_else(dataset: Path) -> None:
    shutil.rmtree(dataset / "rema")
    error = refuse(dataset.parent, InputError, "was not written by `rema export`", dataset.parent.name)
    assert "rema collect" in error.hint


def test_every_file_is_looked_at(dataset: Path) -> None:
    for path in sorted(path for path in dataset.rglob("*") if path.is_file()):
        data = path.read_bytes()
        for changed in (data[: len(data) // 2], data[:-1] + bytes([data[-1] ^ 1]), data + b"\n", None):
            path.unlink()
            if changed is not None:
                path.write_bytes(changed)
            if path.name == "export.json" and changed is None:
                refuse(dataset, InputError, "was not written", dataset.parent.name)
            elif path.name != "export.json" or changed != data + b"\n":  # JSON does not mind
                refuse(dataset, IntegrityError, path.name)
        path.write_bytes(data)


def test_a_truncated_file_and_an_edited_one_are_told_apart(dataset: Path) -> None:
    path = max((path for path in dataset.rglob("*") if path.is_file()), key=lambda path: path.stat().st_size)
    data = path.read_bytes()
    path.write_bytes(data[:-5])
    refuse(dataset, IntegrityError, f"{path.name} .*it is truncated")
    path.write_bytes(b"x" + data[1:])
    refuse(dataset, IntegrityError, f"{path.name} .*it was edited or is damaged")


def test_a_link_is_not_followed(dataset: Path, tmp_path: Path) -> None:
    path = next(path for path in dataset.iterdir() if path.is_file() or path.name != "rema")
    path = path if path.is_file() else next(inner for inner in path.rglob("*") if inner.is_file())
    path.rename(tmp_path / "elsewhere")
    path.symlink_to(tmp_path / "elsewhere")
    refuse(dataset, IntegrityError, f"{path.name} .*it is a link")


def change(field: str, value: Any) -> Callable[[Any], None]:
    def apply(seal: Any) -> None:
        seal["header"][field] = value

    return apply


CHANGES: list[tuple[Callable[[Any], None], type[RemaError], str]] = [
    (change("format_version", 99), InputError, "format version 99, this rema reads 1"),
    (change("schema_version", 99), InputError, "schema version 99"),
    (change("release_sha256", "0" * 64), IntegrityError, "it names another release"),
    (change("blocks", ["round-9/grasp/train"]), IntegrityError, "it names another release"),
    (change("maps", "inches"), IntegrityError, "header.maps"),
    (change("maps", "quantised"), IntegrityError, "is not as it was exported"),
    (change("blocks", 3), IntegrityError, "header.blocks"),
    (lambda seal: seal.update(kind="another"), IntegrityError, "it says that it is a 'another'"),
    (lambda seal: seal["files"][0].update(path="../up"), IntegrityError, "it names the file '../up'"),
    (lambda seal: seal["files"].append({"path": "no", "bytes": 1, "sha256": "0"}), IntegrityError, "no .*cannot be"),
]


@pytest.mark.parametrize("number", range(len(CHANGES)))
def test_a_seal_that_contradicts_the_data_set(number: int, dataset: Path) -> None:
    apply, kind, words = CHANGES[number]
    path = dataset / "rema" / "export.json"
    seal = json.loads(path.read_text())
    apply(seal)
    path.write_text(json.dumps(seal))
    refuse(dataset, kind, words)


def test_data_sets_of_two_releases_are_not_mixed(dataset: Path, tmp_path: Path) -> None:
    other = make_release(tmp_path / "data", "other", tasks=("push",), episodes=5)
    export_release(other, dataset.parent, dataset.parent.name)
    refuse(dataset.parent, InputError, "belongs to the release tiny .*, .* to other|to tiny")


def test_a_data_set_named_twice_is_refused(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="both hold round-1/grasp/train"):
        import_release([dataset, dataset.parent], tmp_path / "back", "part")


def test_a_damaged_export_is_not_taken_for_a_finished_one(dataset: Path, release: ReleaseFolder) -> None:
    path = max((path for path in dataset.rglob("*") if path.is_file()), key=lambda path: path.stat().st_size)
    path.write_bytes(b"x" + path.read_bytes()[1:])
    with pytest.raises(IntegrityError, match=path.name):
        export_release(release, dataset.parent, dataset.parent.name, tasks=["grasp"])


def test_a_folder_of_somebody_else_is_not_overwritten(dataset: Path, release: ReleaseFolder) -> None:
    shutil.rmtree(dataset / "rema")
    before = files(dataset)
    with pytest.raises(RunMismatchError, match="is not this export"):
        export_release(release, dataset.parent, dataset.parent.name, tasks=["grasp"])
    assert files(dataset) == before


def test_a_file_is_not_a_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("text")
    with pytest.raises(MissingFileError, match="file is not a folder"):
        import_release([tmp_path / "file"], tmp_path / "back", format="lerobot")
