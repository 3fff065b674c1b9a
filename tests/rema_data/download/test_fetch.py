"""The call: parts of a release, dry runs, offline, what is in the way, and interruption."""

from __future__ import annotations

import json
import resource
import shutil
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from rema_data.download import download
from rema_data.errors import InputError, IntegrityError, MissingFileError, RunMismatchError, StorageError
from rema_data.progress import Silent
from rema_data.release.folder import downloads_folder
from rema_data.release.manifest import MANIFEST
from rema_data.release.registry import register
from rema_data.store.block import BlockKey
from rema_data.testing import make_release
from tests.rema_data.download.conftest import BLOCK, Publish, fetched
from tests.rema_data.download.servers import Fault, serve

PARTS = {
    "round-1/grasp/train/a": 100,
    "round-1/grasp/val/a": 10,
    "round-1/push/train/a": 1000,
    "round-2/grasp/train/a": 200,
    "card.json": 5,
}


class Usage(NamedTuple):
    total: int
    used: int
    free: int


class Recorder(Silent):
    """Progress that remembers."""

    def __init__(self) -> None:
        self.total = self.done = 0
        self.notes: list[str] = []

    def phase(self, name: str, total: int) -> None:
        self.total = total

    def advance(self, n: int) -> None:
        self.done += n

    def note(self, text: str) -> None:
        self.notes.append(text)


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        ({}, set(PARTS)),
        ({"tasks": ["push"]}, {"round-1/push/train/a", "card.json"}),
        ({"tasks": ["grasp"], "split": "train"}, {"round-1/grasp/train/a", "round-2/grasp/train/a", "card.json"}),
        ({"rounds": [2]}, {"round-2/grasp/train/a", "card.json"}),
    ],
)
def test_parts_are_sets_of_whole_files(publish: Publish, part: dict[str, Any], expected: set[str]) -> None:
    tiny = publish(sizes=PARTS)
    report = download("tiny", sources=[tiny.folder], **part)
    assert set(fetched()) == {f"tiny/{path}" for path in expected} and report.files == len(expected)
    rest = download("tiny", sources=[tiny.folder])
    assert rest.present_files == len(expected) and fetched() == tiny.content()


def test_what_a_release_does_not_have(publish: Publish) -> None:
    publish(sizes=PARTS)
    for part in ({"tasks": ["fly"]}, {"rounds": [3]}, {"split": "test"}, {"tasks": ["push"], "rounds": [2]}):
        with pytest.raises(InputError, match="no (task|round|split|block)"):
            download("tiny", **part)
    with pytest.raises(InputError, match="there is no published release 'huge'"):
        download("huge")
    with pytest.raises(InputError, match="0 files at a time"):
        download("tiny", jobs=0)


def test_a_dry_run_touches_nothing(publish: Publish, machine: Path, tmp_path: Path) -> None:
    tiny = publish(sizes=PARTS)
    (tmp_path / "half" / "tiny" / "round-1").mkdir(parents=True)
    shutil.copytree(tiny.folder / "tiny" / "round-1" / "push", tmp_path / "half" / "tiny" / "round-1" / "push")
    with serve(tiny.folder) as server:
        download("tiny", tasks=["grasp"], rounds=[2], sources=[server.url])
        before = fetched()
        asked = len(server.requests)
        report = download("tiny", dry_run=True, sources=["half", server.url])
        assert len(server.requests) == asked
    assert fetched() == before
    assert (report.files, report.present_files, report.fetched_files, report.moved_bytes) == (5, 2, 0, 0)
    rows = {row.block: (row.missing_files, row.missing_bytes, row.source) for row in report.blocks}
    assert rows["round-1/push/train"] == (1, 1000, str(tmp_path / "half"))
    assert rows["round-1/grasp/train"] == (1, 100, server.url)
    assert rows["round-2/grasp/train"] == rows["(release)"] == (0, 0, "")
    assert json.loads(json.dumps(report.to_dict()))["dry_run"] is True


def test_a_dry_run_on_an_empty_machine(publish: Publish, machine: Path) -> None:
    publish()
    assert download("tiny", dry_run=True).blocks[0].source == ""
    assert not machine.exists()


@pytest.mark.parametrize("by_environment", [False, True])
def test_offline(publish: Publish, monkeypatch: pytest.MonkeyPatch, by_environment: bool) -> None:
    tiny = publish()
    if by_environment:
        monkeypatch.setenv("REMA_OFFLINE", "1")
    with serve(tiny.folder) as server:
        with pytest.raises(MissingFileError, match="3 of 3 files") as caught:
            download("tiny", sources=[server.url], offline=not by_environment)
        assert "tiny/DATASHEET.md and 2 more" in caught.value.message and "--source FOLDER" in caught.value.hint
        assert download("tiny", sources=[server.url, tiny.folder], offline=True).sources == {str(tiny.folder): 3}
        assert download("tiny", sources=[server.url], offline=True).present_files == 3
    assert server.requests == []


def test_no_source_at_all(publish: Publish) -> None:
    publish()
    with pytest.raises(MissingFileError, match="no source is known") as caught:
        download("tiny")
    assert caught.value.hint == "name a mirror: rema download tiny --source URL"


def test_a_failed_download_leaves_no_empty_folders(publish: Publish) -> None:
    tiny = publish(sizes=PARTS)
    (tiny.folder / "tiny" / "round-1" / "push" / "train" / "a").unlink()
    root = downloads_folder()
    with pytest.raises(MissingFileError):
        download("tiny", sources=["nowhere"])
    assert [path.name for path in root.iterdir()] == [".tiny.lock"]
    with pytest.raises(MissingFileError) as caught:
        download("tiny", sources=[tiny.folder])
    assert "same command again" not in caught.value.hint
    folders = {path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_dir()}
    assert "tiny/round-1/push" not in folders and "tiny/round-1/grasp/train" in folders


def test_mirrors_of_the_manifest_come_last(publish: Publish, tmp_path: Path) -> None:
    tiny = publish(sources=[str(tmp_path / "mirror")])
    report = download("tiny", sources=["nowhere"])
    assert report.asked == (str(tmp_path / "nowhere"), str(tiny.folder)) and report.sources == {str(tiny.folder): 3}


def test_blocks_of_a_parent_are_fetched_once_to_its_folder(tmp_path: Path) -> None:
    mirror = tmp_path / "mirror"
    parent = make_release(mirror, "first", tasks=["grasp"], episodes=3)
    child = make_release(
        mirror, "second", tasks=["push"], episodes=3, parent=parent.manifest, reused=[BlockKey(1, "grasp", "train")]
    )
    for release in (parent, child):
        register(release.manifest)
    report = download("second", sources=[mirror])
    assert {path.split("/")[0] for path in fetched()} == {"first", "second"}
    assert download("second").present_files == report.files
    rest = download("first", sources=[mirror])
    assert rest.present_files == sum(file.block == BLOCK for file in parent.manifest.files) > 0
    files = {file.location for release in (parent, child) for file in release.manifest.files}
    assert set(fetched()) == files


def test_an_unpublished_release_by_its_manifest(publish: Publish, tmp_path: Path) -> None:
    tiny = publish()
    (tmp_path / "manifests" / "datasets" / "index.json").write_text('{"releases": []}')
    path = tmp_path / "given.json"
    path.write_bytes(tiny.manifest.to_bytes())
    assert download(manifest=path, sources=[tiny.folder]).name == "tiny" and fetched() == tiny.content()
    with pytest.raises(InputError, match="is the manifest of tiny, not of other"):
        download("other", manifest=path)
    with pytest.raises(MissingFileError, match="cannot be read"):
        download(manifest=tmp_path / "none.json")
    shutil.rmtree(downloads_folder())
    with pytest.raises(MissingFileError) as missing:
        download(manifest=path)
    assert missing.value.hint == f"name a mirror: rema download tiny --manifest {path} --source URL"
    path.write_bytes(b"{}")
    with pytest.raises(IntegrityError) as broken:
        download(manifest=path)
    assert broken.value.hint == f"copy {path} again from where it came from"


def test_another_release_of_the_same_name_is_in_the_way(publish: Publish) -> None:
    tiny = publish()
    (downloads_folder() / "tiny").mkdir(parents=True)
    (downloads_folder() / "tiny" / "manifest.json").write_text("{}")
    with pytest.raises(RunMismatchError, match="another release of the name tiny") as caught:
        download("tiny", sources=[tiny.folder])
    assert "mv " in caught.value.hint and fetched() == {}


def test_what_came_with_another_release_of_the_name_is_fetched_again(publish: Publish) -> None:
    """A download that was stopped has no manifest yet, and a file of the same size may be another one's."""
    tiny = publish()
    download("tiny", sources=[tiny.folder])
    whole = fetched()
    (downloads_folder() / "tiny" / MANIFEST).unlink()
    card = downloads_folder() / "tiny" / "DATASHEET.md"
    card.chmod(0o644)
    card.write_bytes(bytes(len(card.read_bytes())))
    report = download("tiny", sources=[tiny.folder])
    assert report.fetched_files == 1 and fetched() == whole


def test_progress_counts_bytes(publish: Publish) -> None:
    tiny = publish()
    part = downloads_folder() / "tiny" / BLOCK / "steps.parquet.part"
    part.parent.mkdir(parents=True)
    part.write_bytes(b"wrong")
    recorder = Recorder()
    download("tiny", sources=[tiny.folder], progress=recorder)
    assert recorder.total == recorder.done == tiny.size() and recorder.notes == []


def test_disk_space_is_checked_before(publish: Publish, machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny = publish()
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(10**9, 10**9 - 100_000, 100_000))
    with pytest.raises(StorageError, match=r"needs 200\.6 kB at .* 100\.0 kB are free") as caught:
        download("tiny", sources=[tiny.folder])
    assert "REMA_HOME" in caught.value.hint and fetched() == {}
    part = downloads_folder() / "tiny" / BLOCK / "steps.parquet.part"
    part.parent.mkdir(parents=True)
    part.write_bytes((tiny.folder / "tiny" / BLOCK / "steps.parquet").read_bytes()[:150_000])
    download("tiny", sources=[tiny.folder])  # what an earlier run has left needs no more room
    assert fetched() == tiny.content()


def test_a_full_disk_keeps_what_has_arrived(publish: Publish) -> None:
    tiny = publish(sizes={f"{BLOCK}/steps.parquet": 3_000_000, "DATASHEET.md": 500})
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_500_000, hard))
    try:
        with pytest.raises(StorageError, match="larger than is allowed") as caught:
            download("tiny", sources=[tiny.folder])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert "resumes" in caught.value.hint
    assert not (downloads_folder() / "tiny" / BLOCK / "steps.parquet").exists()
    report = download("tiny", sources=[tiny.folder])
    assert fetched() == tiny.content() and report.moved_bytes <= 1_500_500


@pytest.mark.parametrize("home", ["file", "/proc/rema"])
def test_a_home_that_may_not_be_written(
    publish: Publish, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, home: str
) -> None:
    tiny = publish()
    (tmp_path / "file").touch()
    monkeypatch.setenv("REMA_HOME", str(tmp_path / home))
    with pytest.raises(StorageError, match="cannot write") as caught:
        download("tiny", sources=[tiny.folder])
    assert caught.value.hint


def test_a_whole_release_needs_no_writing(publish: Publish, machine: Path) -> None:
    """As on a cluster, where the home of the releases is mounted read-only."""
    tiny = publish()
    download("tiny", sources=[tiny.folder])

    paths = [machine, *machine.rglob("*")]
    before = [(path, path.stat().st_mtime_ns) for path in paths]
    assert download("tiny").present_files == 3
    assert before == [(path, path.stat().st_mtime_ns) for path in [machine, *machine.rglob("*")]]


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Python's own answer to Ctrl-C, which a process that was started in the background does not have."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_an_interruption_ends_soon_and_keeps_what_has_arrived(publish: Publish) -> None:
    """Ctrl-C while a server sends nothing."""
    tiny = publish(sizes={f"{BLOCK}/steps.parquet": 3_000_000})
    main = threading.main_thread().ident
    assert main is not None

    class Interrupting(Recorder):
        def advance(self, n: int) -> None:
            super().advance(n)
            if self.done == 2_000_000:
                signal.pthread_kill(main, signal.SIGINT)

    with serve(tiny.folder, lambda path, count: Fault("stall", 2_000_000)) as server:
        with pytest.raises(KeyboardInterrupt):
            download("tiny", sources=[server.url], progress=Interrupting())
        parts = {path: len(data) for path, data in fetched().items()}
        assert parts == {f"tiny/{BLOCK}/steps.parquet.part": 2_000_000}
        server.ended.set()
        server.faults = lambda path, count: None
        report = download("tiny", sources=[server.url])
    assert fetched() == tiny.content() and report.moved_bytes == 1_000_000


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_damaged_file_of_the_right_size_is_found_and_fetched_with_verify(publish: Publish, number: int) -> None:
    tiny = publish()
    report = download("tiny", sources=[tiny.folder])
    entry = tiny.manifest.files[number]
    path = report.root / entry.location
    path.chmod(0o644)
    path.write_bytes(bytes(entry.bytes))
    assert download("tiny", sources=[tiny.folder]).fetched_files == 0
    again = download("tiny", sources=[tiny.folder], verify=True)
    assert (again.fetched_files, again.present_files) == (1, 2) and fetched() == tiny.content()
    assert download("tiny", sources=["nowhere"], verify=True).fetched_files == 0
