"""A published folder: a source of downloads, what `rema verify` checks, and what the hub and `datasets` read."""

from __future__ import annotations

import errno
import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
import yaml

from rema_data import interrupts
from rema_data.download import download
from rema_data.errors import InputError, IntegrityError, MissingFileError, RunMismatchError, StorageError
from rema_data.publish import dataset as module
from rema_data.publish import publish_release
from rema_data.publish.card import size_category
from rema_data.release.folder import ReleaseFolder, find_release
from rema_data.testing import make_release
from rema_data.verify import verify


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    """Eight training and two validation episodes of two tasks. Only to be read."""
    return make_release(tmp_path_factory.mktemp("sealed"), tasks=("grasp", "grasp_push"), episodes=8)


@pytest.fixture(scope="module")
def published(release: ReleaseFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("published") / "pushed"
    publish_release(release, target, "lab/made")
    return target


def front_matter(card: str) -> dict[str, Any]:
    _, matter, _ = card.split("---\n", 2)
    content: dict[str, Any] = yaml.safe_load(matter)
    return content


def test_the_folder_is_a_release_that_verify_checks(release: ReleaseFolder, published: Path) -> None:
    found = find_release(published)
    assert found.manifest.sha256 == release.manifest.sha256 and found.path.parent == published.resolve()
    assert verify(found).ok


def test_the_folder_is_a_source(
    release: ReleaseFolder, published: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("REMA_HOME", str(tmp_path))
    name = release.manifest.name
    report = download(name, sources=[published], manifest=published / name / "manifest.json")
    assert report.sources == {str(published): len(release.manifest.files)}


def test_every_file_is_in_the_checksums(published: Path) -> None:
    lines = [line.split("  ", 1) for line in (published / "SHA256SUMS").read_text().splitlines()]
    files = {p.relative_to(published).as_posix() for p in published.rglob("*") if p.is_file()} - {"SHA256SUMS"}
    assert {path for _, path in lines} == files
    assert all(hashlib.sha256((published / path).read_bytes()).hexdigest() == digest for digest, path in lines)


def test_the_card_says_what_the_hub_asks(release: ReleaseFolder, published: Path) -> None:
    card = (published / "README.md").read_text()
    matter = front_matter(card)
    assert matter["pretty_name"] == release.manifest.title
    assert matter["license"] == release.manifest.license.lower()
    assert matter["size_categories"] == ["n<1K"] and matter["task_categories"] == ["robotics"]
    assert "--source hf://datasets/lab/made" in card and 'load_dataset("lab/made", "grasp"' in card


def test_every_configuration_has_its_rows(release: ReleaseFolder, published: Path) -> None:
    rows = {}
    for config in front_matter((published / "README.md").read_text())["configs"]:
        for files in config["data_files"]:
            found = list(published.glob(files["path"]))
            assert found, files
            rows[config["config_name"], files["split"]] = sum(pq.read_metadata(path).num_rows for path in found)
    assert rows == {(block.task, block.split): block.steps for block in release.manifest.blocks}


def test_without_maps_in_parquet_the_tables_are_shown(release: ReleaseFolder, tmp_path: Path) -> None:
    publish_release(release, tmp_path / "plain", viewer=False)
    assert not (tmp_path / "plain" / "viewer").exists()
    configs = front_matter((tmp_path / "plain" / "README.md").read_text())["configs"]
    assert [config["config_name"] for config in configs] == ["steps", "episodes"]
    counts = {"steps": 0, "episodes": 0}
    for config in configs:
        for files in config["data_files"]:
            found = tmp_path.glob(f"plain/{files['path']}")
            counts[config["config_name"]] += sum(pq.read_metadata(path).num_rows for path in found)
    assert counts == {name: release.manifest.counts[name] for name in counts}


@pytest.mark.filterwarnings(
    "ignore::DeprecationWarning", "ignore::FutureWarning"
)  # mlcroissant uses what rdflib deprecates
def test_croissant_reads_the_tables_from_the_top(release: ReleaseFolder, published: Path) -> None:
    content = json.loads((published / "croissant.json").read_text())
    tables = [entry for entry in content["distribution"] if entry["@type"] == "cr:FileObject"]
    assert tables
    for entry in tables:
        assert hashlib.sha256((published / entry["contentUrl"]).read_bytes()).hexdigest() == entry["sha256"]
    for entry in content["distribution"]:
        for pattern in entry.get("includes", ()):
            assert any(published.glob(pattern)), pattern
    mlcroissant = pytest.importorskip("mlcroissant")
    dataset = mlcroissant.Dataset(jsonld=str(published / "croissant.json"))
    assert sum(1 for _ in dataset.records("episodes")) == release.manifest.counts["episodes"]


@pytest.mark.parametrize(
    ("rows", "category"),
    [(1, "n<1K"), (999, "n<1K"), (1000, "1K<n<10K"), (25_200, "10K<n<100K"), (999_999, "100K<n<1M")],
)
def test_size_categories(rows: int, category: str) -> None:
    assert size_category(rows) == category


def test_another_folder_is_not_written_to(release: ReleaseFolder, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "note").write_text("mine")
    with pytest.raises(RunMismatchError, match="choose another folder with --to"):
        publish_release(release, tmp_path / "mine")
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["note"]
    (tmp_path / "empty").mkdir()
    publish_release(release, tmp_path / "empty", viewer=False)
    assert (tmp_path / "empty" / "SHA256SUMS").is_file()


@pytest.mark.parametrize("name", ["data", "lab/data/more", "la b/data", "../data", "lab/--x\n"])
def test_a_repository_has_an_owner_and_a_name(release: ReleaseFolder, tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="--repo ORG/NAME"):
        publish_release(release, tmp_path / "new", name)
    assert not list(tmp_path.iterdir())


@pytest.fixture
def damaged(release: ReleaseFolder, tmp_path: Path) -> ReleaseFolder:
    shutil.copytree(release.path, tmp_path / "sealed" / release.manifest.name)
    return ReleaseFolder(release.manifest, tmp_path / "sealed")


def test_other_bytes_are_not_published(damaged: ReleaseFolder, tmp_path: Path) -> None:
    path = damaged.file(damaged.manifest.files[-1])
    path.chmod(0o644)
    path.write_bytes(bytes(byte ^ 1 for byte in path.read_bytes()))
    with pytest.raises(IntegrityError, match="not the file that was sealed"):
        publish_release(damaged, tmp_path / "out" / "new")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("last", [True, False])
def test_a_part_of_a_release_is_not_published(damaged: ReleaseFolder, tmp_path: Path, last: bool) -> None:
    files = damaged.manifest.files
    missing = files[-1] if last else next(file for file in files if file.block is None)
    damaged.file(missing).unlink()
    with pytest.raises(MissingFileError):
        publish_release(damaged, tmp_path / "out" / "new")
    assert not (tmp_path / "out").exists()


def test_a_full_disk_leaves_nothing(release: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(source: Path, target: Path) -> None:
        target.write_bytes(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(module.shutil, "copyfile", full)
    with pytest.raises(StorageError, match="no space is left"):
        publish_release(release, tmp_path / "out" / "new")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("look", [1, 10, 30])
def test_an_interrupt_leaves_nothing(
    release: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, look: int
) -> None:
    looks = iter(range(1, 1000))

    def check() -> None:
        if next(looks) == look:
            raise interrupts.Interrupted(15)

    monkeypatch.setattr(module.interrupts, "check", check)
    with pytest.raises(KeyboardInterrupt):
        publish_release(release, tmp_path / "out" / "new")
    assert not (tmp_path / "out").exists()
