"""``rema verify``: exit code, table, JSON."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from evaluator.cli.main import cli
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST
from rema_data.release.registry import register
from tests.rema_data.verify.damage import GRASP_TRAIN, copy, flip, location, make_whole, write_manifests

SHARD = "maps.zarr/scene/c/0/0/0"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    return make_whole(tmp_path_factory.mktemp("whole"), tasks=("grasp", "push"), episodes=5)


@pytest.fixture
def release(whole: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ReleaseFolder:
    write_manifests(tmp_path / "manifests")
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("COLUMNS", "300")
    monkeypatch.chdir(tmp_path)
    return copy(whole, tmp_path / "data")


def verify(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, ["verify", *map(str, arguments)])


def test_nothing_is_wrong(release: ReleaseFolder) -> None:
    result = verify(release.path)
    assert result.exit_code == 0, result.output
    assert "nothing is wrong" in result.stdout
    assert "12 episodes" in result.stdout
    assert "files: " in result.stderr


def test_findings_are_printed_with_their_fixes(release: ReleaseFolder) -> None:
    flip(release.root / location(release, GRASP_TRAIN, SHARD), 100)
    (release.path / "notes.txt").touch()
    result = verify(release.path)
    assert result.exit_code == 6
    line = next(line for line in result.stdout.splitlines() if SHARD in line)
    assert line.split()[:2] == ["sha256", location(release, GRASP_TRAIN, SHARD)]
    assert f"rm {release.path / 'notes.txt'}" in result.stdout
    assert "contents not checked, or not all: round-1/grasp/train" in result.stdout
    assert verify(release.path, "--task", "push").exit_code == 6  # the additional file is nobody's
    (release.path / "notes.txt").unlink()
    assert verify(release.path, "--task", "push").exit_code == 0
    assert verify(release.path, "--split", "val", "--round", "1").exit_code == 0


def test_json_is_alone_on_stdout(release: ReleaseFolder) -> None:
    (release.root / location(release, GRASP_TRAIN, SHARD)).unlink()
    result = verify(release.path, "--json")
    assert result.exit_code == 6
    printed = json.loads(result.stdout)
    assert not printed["ok"]
    assert printed["counts"] == {"missing": 1}
    (finding,) = printed["findings"]
    assert sorted(finding) == ["detail", "file", "fix", "kind", "where"]
    assert finding["file"] == str(release.root / location(release, GRASP_TRAIN, SHARD))


def test_further_findings_are_counted(release: ReleaseFolder) -> None:
    for number in range(23):
        (release.path / f"extra-{number:02d}").touch()
    result = verify(release.path)
    assert "3 more of the kind unexpected" in result.stdout
    assert "... and 10 more" in result.stdout


def test_repair(release: ReleaseFolder, whole: ReleaseFolder, tmp_path: Path) -> None:
    register(whole.manifest)
    downloaded = copy(whole, tmp_path / "home" / "releases")
    copy(whole, tmp_path / "releases")
    place = location(downloaded, GRASP_TRAIN, SHARD)
    flip(downloaded.root / place, 100)
    result = verify("tiny")
    assert result.exit_code == 6 and "rema verify tiny --repair" in result.stdout
    result = verify("tiny", "--repair")
    assert result.exit_code == 0, result.output
    assert "fetched 1 files again" in result.stderr
    assert (downloaded.root / place).read_bytes() == whole.root.joinpath(place).read_bytes()


def test_repair_from_a_source(release: ReleaseFolder, whole: ReleaseFolder, tmp_path: Path) -> None:
    register(whole.manifest)
    downloaded = copy(whole, tmp_path / "home" / "releases")
    path = downloaded.root / location(downloaded, GRASP_TRAIN, SHARD)
    flip(path, 100)
    damaged = path.read_bytes()
    result = verify("tiny", "--repair")
    assert result.exit_code == 2 and "name a mirror: rema verify tiny --repair --source URL" in result.stderr
    assert path.read_bytes() == damaged
    result = verify("tiny", "--repair", "--source", tmp_path / "nowhere", "--source", whole.root)
    assert result.exit_code == 0, result.output
    result = verify("tiny", "--source", whole.root)
    assert result.exit_code == 2 and "--source is for --repair" in result.stderr


def test_a_folder_that_was_not_downloaded_is_not_repaired(release: ReleaseFolder) -> None:
    flip(release.root / location(release, GRASP_TRAIN, SHARD), 100)
    result = verify(release.path, "--repair")
    assert result.exit_code == 2 and "was not downloaded" in result.stderr


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (lambda path: path.write_bytes(b"{}"), 6, "cannot be used"),
        (lambda path: path.unlink(), 2, "is not the folder of a sealed release"),
    ],
)
def test_no_manifest_no_verification(release: ReleaseFolder, change: object, code: int, words: str) -> None:
    change(release.path / MANIFEST)  # type: ignore[operator]
    result = verify(release.path)
    assert result.exit_code == code and words in result.stderr


def test_bad_options(release: ReleaseFolder) -> None:
    assert verify(release.path, "--round", "9").exit_code == 2
    assert verify(release.path, "--task", "juggle").exit_code == 2
    result = verify("nothing")
    assert result.exit_code == 2 and "neither a published release nor a folder" in result.stderr
