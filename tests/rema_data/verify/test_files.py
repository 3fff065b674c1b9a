"""Every damaged byte and every missing or additional file is found, named, and has a command that fixes it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rema_data.errors import InputError
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST
from rema_data.release.registry import register
from rema_data.repair import reinstall
from rema_data.verify import Finding, verify
from rema_data.verify.findings import LISTED_OF_A_KIND
from tests.rema_data.verify.damage import GRASP_TRAIN, flip, location, make_whole, reseal

SHARD = "maps.zarr/scene/c/0/0/0"


class Sink:
    """Counts what a verification says of its progress."""

    def __init__(self) -> None:
        self.totals: dict[str, int] = {}
        self.done: dict[str, int] = {}

    def phase(self, name: str, total: int) -> None:
        self.totals[name] = total
        self.done[name] = 0

    def advance(self, n: int) -> None:
        self.done[list(self.done)[-1]] += n


def only(release: ReleaseFolder) -> Finding:
    (finding,) = verify(release).findings
    return finding


def test_whole_release_of_all_tasks_passes(whole: ReleaseFolder, manifests: Path) -> None:
    progress = Sink()
    report = verify(whole, progress=progress)
    assert report.findings == () and report.ok
    counts = whole.manifest.counts
    assert {name: report.checked[name] for name in counts if name != "positives"} == {
        name: count for name, count in counts.items() if name != "positives"
    }
    assert progress.done == progress.totals
    assert progress.totals["files"] == counts["files"]


def test_flipped_byte_in_a_shard(release: ReleaseFolder) -> None:
    place = location(release, GRASP_TRAIN, SHARD)
    flip(release.root / place, 100)
    report = verify(release)
    assert report.damaged == [place] and report.unread == [GRASP_TRAIN.path]
    (finding,) = report.findings
    assert (finding.kind, finding.file) == ("sha256", str(release.root / place))
    assert "rema collect" in finding.fix


@given(st.data())
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_flipped_bit_is_found(release: ReleaseFolder, data: st.DataObject) -> None:
    entry = data.draw(st.sampled_from(release.manifest.files))
    offset, bit = data.draw(st.integers(0, entry.bytes - 1)), data.draw(st.integers(0, 7))
    flip(release.file(entry), offset, bit)
    wanted = (None, None, None)
    if entry.block is not None:
        number, task, split = entry.block.split("/")
        wanted = ([task], [int(number.removeprefix("round-"))], split)
    try:
        assert verify(release, *wanted).damaged == [entry.location]
    finally:
        flip(release.file(entry), offset, bit)


def test_deleted_shard(release: ReleaseFolder) -> None:
    place = location(release, GRASP_TRAIN, SHARD)
    (release.root / place).unlink()
    finding = only(release)
    assert (finding.kind, finding.file) == ("missing", str(release.root / place))


def test_truncated_table(release: ReleaseFolder) -> None:
    path = release.root / location(release, GRASP_TRAIN, "steps.parquet")
    path.write_bytes(path.read_bytes()[:1000])
    finding = only(release)
    assert (finding.kind, finding.file) == ("size", str(path))
    assert "1,000 bytes" in finding.detail


def test_sealed_table_that_is_none(release: ReleaseFolder) -> None:
    place = location(release, GRASP_TRAIN, "episodes.parquet")
    finding = only(reseal(release, {place: b"PAR1 but no table PAR1"}))
    assert (finding.kind, finding.file) == ("table", str(release.root / place))


def test_unexpected_file(release: ReleaseFolder) -> None:
    path = release.path / GRASP_TRAIN.path / "notes.txt"
    path.write_text("hello")
    finding = only(release)
    assert (finding.kind, finding.file, finding.fix) == ("unexpected", str(path), f"delete it: rm {path}")


def test_manifest_beside_the_data_is_another(release: ReleaseFolder) -> None:
    path = release.path / MANIFEST
    path.write_bytes(path.read_bytes().replace(b"Synthetic", b"Synthetik"))
    finding = only(release)
    assert (finding.kind, finding.file) == ("manifest", str(path))
    path.unlink()
    assert only(release).kind == "missing"


def test_other_content_under_a_published_name(release: ReleaseFolder, tmp_path: Path) -> None:
    register(make_whole(tmp_path / "other", tasks=("grasp",), episodes=5).manifest)
    finding = only(release)
    assert finding.kind == "manifest" and "not the published tiny" in finding.detail


def test_only_the_first_findings_of_a_kind_are_listed(release: ReleaseFolder) -> None:
    extra = LISTED_OF_A_KIND + 7
    for number in range(extra):
        (release.path / f"extra-{number}").touch()
    report = verify(release)
    assert len(report.findings) == LISTED_OF_A_KIND
    assert report.counts == {"unexpected": extra}


def test_subset(release: ReleaseFolder) -> None:
    flip(release.root / location(release, GRASP_TRAIN, SHARD), 100)
    assert verify(release, tasks=["push"]).ok
    assert verify(release, split="val").ok
    assert not verify(release, tasks=["grasp"], split="train").ok
    with pytest.raises(InputError, match="no round 7"):
        verify(release, rounds=[7])


def test_blocks_that_were_not_downloaded(downloaded: ReleaseFolder) -> None:
    """A subset is no damage, but a block that is partly there is, and so is one that is asked for."""
    shutil.rmtree(downloaded.path / "round-1/push")
    report = verify(downloaded)
    assert report.ok and report.absent == ["round-1/push/train", "round-1/push/val"]
    assert not verify(downloaded, tasks=["push"]).ok
    (downloaded.root / location(downloaded, GRASP_TRAIN, SHARD)).unlink()
    assert only(downloaded).kind == "missing"


def test_unfinished_download_is_not_unexpected(downloaded: ReleaseFolder) -> None:
    (downloaded.path / "steps.parquet.part").touch()
    assert verify(downloaded).ok


def test_mending_command_depends_on_the_place(
    release: ReleaseFolder, downloaded: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in (release, downloaded):
        flip(folder.root / location(folder, GRASP_TRAIN, SHARD), 100)
    assert only(downloaded).fix == "rema verify tiny --repair --source URL"
    assert only(release).fix.endswith("open them by their name: rema download tiny --source URL")
    (tmp_path / ".git").mkdir()
    assert only(release).fix == f"git checkout -- data/tiny/{GRASP_TRAIN.path}/{SHARD}"
    bundled = tmp_path / "_releases"
    release.root.rename(bundled)
    assert only(ReleaseFolder(release.manifest, bundled)).fix == reinstall()
