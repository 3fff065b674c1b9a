"""Sources other than web servers, and URLs that cannot be sources."""

from __future__ import annotations

import sys
import zipfile
from importlib import import_module
from pathlib import Path

import fsspec
import pytest

import rema_data.download.fetch as fetch
from rema_data.download import download
from rema_data.errors import InputError, IntegrityError, MissingFileError
from rema_data.release.folder import local_sources
from rema_data.testing import make_release
from tests.rema_data.download.conftest import BLOCK, Publish, fetched


@pytest.mark.parametrize("form", ["{}", "file://{}", "local://{}"])
def test_a_folder(publish: Publish, form: str) -> None:
    tiny = publish()
    url = form.format(tiny.folder)
    assert download("tiny", sources=[url]).sources == {url: 3}
    assert fetched() == tiny.content()


def test_a_path_relative_to_the_current_folder(publish: Publish) -> None:
    tiny = publish()
    download("tiny", sources=[Path("mirror")])
    assert fetched() == tiny.content()


@pytest.mark.parametrize("form", ["{}/tiny", "file://{}/tiny/"])
def test_the_folder_of_the_release_itself(publish: Publish, form: str) -> None:
    tiny = publish()
    url = form.format(tiny.folder)
    planned = download("tiny", sources=[url], dry_run=True)
    assert {row.source for row in planned.blocks} == {url}
    assert download("tiny", sources=[url]).sources == {url: 3}
    assert fetched() == tiny.content()


def test_what_fsspec_opens(publish: Publish, tmp_path: Path) -> None:
    """A store in blocks, and a chain of protocols; the second begins in the middle of a file."""
    tiny = publish(sizes={f"{BLOCK}/steps.parquet": 5_000_000})
    memory = fsspec.filesystem("memory")
    with zipfile.ZipFile(tmp_path / "all.zip", "w") as archive:
        for location, data in tiny.content().items():
            memory.pipe(f"/bucket/{location}", data)
            archive.writestr(location, data)
    assert download("tiny", sources=["memory://bucket"]).sources == {"memory://bucket": 1}
    (file,) = (tmp_path / "home" / "releases").rglob("steps.parquet")
    half = file.read_bytes()[:2_500_001]
    file.unlink()
    file.with_name("steps.parquet.part").write_bytes(half)
    report = download("tiny", sources=[f"zip://::{tmp_path / 'all.zip'}"])
    assert fetched() == tiny.content() and report.moved_bytes == 2_499_999
    memory.rm("/bucket", recursive=True)


def test_a_clone_needs_no_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, publish: Publish) -> None:
    monkeypatch.setattr(fetch, "local_sources", local_sources)
    tiny = publish(sources=["http://127.0.0.1:9/never"])
    (tmp_path / "mirror").rename(tmp_path / "releases")
    report = download()
    assert report.sources == {str(tmp_path / "releases"): 3} and report.fetched_bytes == tiny.size()


def test_folders_that_lack_it(publish: Publish, tmp_path: Path) -> None:
    tiny = publish()
    (tmp_path / "empty").mkdir()
    (tmp_path / "odd" / "tiny" / "DATASHEET.md").mkdir(parents=True)
    with pytest.raises(MissingFileError) as caught:
        download("tiny", sources=["empty", "nowhere", "odd", tmp_path / "odd" / "tiny"])
    assert "empty: does not have it" in caught.value.message
    assert "nowhere: there is no such folder" in caught.value.message
    assert download("tiny", sources=["empty", "nowhere", "odd", tiny.folder]).sources == {str(tiny.folder): 3}


def test_a_damaged_folder(publish: Publish) -> None:
    tiny = publish()
    (tiny.folder / "tiny" / "DATASHEET.md").write_bytes(b"x" * 500)
    (tiny.folder / "tiny" / BLOCK / "steps.parquet").write_bytes(b"short")
    with pytest.raises(IntegrityError) as caught:
        download("tiny", sources=[tiny.folder])
    assert "sent other bytes" in caught.value.message and "has 5 bytes there, expected 200,000" in caught.value.message


@pytest.mark.parametrize("url", ["", "  ", "gopher://host/releases"])
def test_urls_that_cannot_be_sources(publish: Publish, url: str) -> None:
    publish()
    with pytest.raises(InputError, match="source") as caught:
        download("tiny", sources=[url])
    assert caught.value.hint


def test_s3_without_its_package(publish: Publish, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny = publish(sources=["s3://bucket/releases"])
    monkeypatch.setitem(sys.modules, "s3fs", None)
    for name in ("s3", "s3a"):
        monkeypatch.delitem(import_module("fsspec.registry")._registry, name, raising=False)
    with pytest.raises(InputError, match="s3://bucket") as caught:
        download("tiny", sources=["s3://bucket"])
    assert 'pip install "rema[s3]"' in caught.value.hint
    with pytest.raises(MissingFileError, match="s3://bucket/releases: cannot be read here"):
        download("tiny", sources=["empty"])
    assert download("tiny", sources=[tiny.folder]).sources == {str(tiny.folder): 3}


def test_a_real_release_can_be_opened_afterwards(tmp_path: Path) -> None:
    from rema_data.release.folder import find_release
    from rema_data.release.registry import register

    made = make_release(tmp_path / "mirror", episodes=3)
    register(made.manifest)
    download("tiny", tasks=["grasp"], split="val", sources=[tmp_path / "mirror"])
    (block,) = find_release("tiny").blocks()
    assert block.key == (1, "grasp", "val") and find_release("tiny").block(block).episodes().num_rows == 1
    assert find_release(tmp_path / "home" / "releases" / "tiny").manifest == made.manifest
