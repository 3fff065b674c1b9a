"""``rema export`` and ``rema import``: out, back, and what they say."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import h5py
import pytest
from click.testing import CliRunner, Result

from evaluator.cli.main import cli
from rema_data.release.folder import ReleaseFolder
from rema_data.release.registry import register
from rema_data.testing import make_release


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    return make_release(tmp_path_factory.mktemp("data"), tasks=("grasp", "push"), episodes=5)


@pytest.fixture
def release(made: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ReleaseFolder:
    (tmp_path / "manifests" / "datasets").mkdir(parents=True)
    (tmp_path / "manifests" / "datasets" / "index.json").write_text('{"releases": []}')
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("COLUMNS", "300")
    monkeypatch.chdir(tmp_path)
    return made


def rema(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, [*map(str, arguments)])


def test_out_and_back(release: ReleaseFolder) -> None:
    out = rema("export", release.path, "--output", "exported")
    assert out.exit_code == 0, out.output
    assert sorted(path.name for path in Path("exported").iterdir()) == ["grasp.hdf5", "push.hdf5"]
    assert "export grasp: 6/6" in out.stderr
    (line,) = (line for line in out.stdout.splitlines() if "push.hdf5" in line)
    size = Path("exported/push.hdf5").stat().st_size
    assert line.split() == ["exported/push.hdf5", "6", "6", f"{size:,}", f"{size / 6:,.0f}"]
    back = rema("import", "exported")
    assert back.exit_code == 0, back.output
    assert f"identical to the exported tiny ({release.manifest.sha256})" in back.stdout
    assert Path("releases/tiny/manifest.json").read_bytes() == release.manifest.to_bytes()


def test_a_published_release_by_its_name(release: ReleaseFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    register(release.manifest)
    Path("releases").symlink_to(release.root)
    out = rema("export", "tiny", "--output", "exported", "--task", "push", "--split", "val", "--json")
    assert out.exit_code == 0, out.output
    printed = json.loads(out.stdout)
    assert (printed["release"], printed["sha256"]) == ("tiny", release.manifest.sha256)
    size = Path("exported/push.hdf5").stat().st_size
    assert printed["files"] == [{"path": "exported/push.hdf5", "new": True, "episodes": 1, "steps": 1, "bytes": size}]
    again = rema("export", "tiny", "--output", "exported", "--task", "push", "--split", "val")
    assert "was there already" in again.stdout


def test_a_damaged_shard_has_a_fix_that_works(release: ReleaseFolder, tmp_path: Path) -> None:
    """The release is not published: neither its name nor a download leads anywhere."""
    copy = Path(shutil.copytree(release.path, tmp_path / "data" / "tiny"))
    shard = copy / "round-1" / "push" / "val" / "maps.zarr" / "scene" / "c" / "0" / "0" / "0"
    shard.chmod(0o644)
    data = bytearray(shard.read_bytes())
    data[20] ^= 1
    shard.write_bytes(data)
    out = rema("export", copy, "--output", "exported")
    assert out.exit_code == 6 and f"find all damage: rema verify {copy}" in out.stderr
    assert "copy it again from where the release came from" in out.stderr and "rema download" not in out.stderr
    shard.unlink()
    out = rema("export", copy, "--output", "exported")
    assert out.exit_code == 2 and "rema download" not in out.stderr


def test_options_reach_the_file(release: ReleaseFolder) -> None:
    words = ("--task", "push", "--round", "1", "--maps", "quantised", "--next-obs", "--format", "hdf5")
    assert rema("export", release.path, "--output", "exported", *words).exit_code == 0
    with h5py.File("exported/push.hdf5") as file:
        assert file["data/demo_0/next_obs/scene"].dtype == "uint16"


def test_an_import_says_what_differs(release: ReleaseFolder) -> None:
    rema("export", release.path, "--output", "exported", "--task", "push")
    with h5py.File("exported/push.hdf5", "r+") as file:
        del file["data/demo_2"]
        file["data/demo_1/rewards"][0] = 0.5
    back = rema("import", "exported/push.hdf5", "--output", "mine", "--name", "pushes")
    assert back.exit_code == 0, back.output
    for sentence in (
        "mine/pushes: 5 episodes, 5 steps",
        "the name is pushes, not tiny",
        "round-1/grasp/train: not part of the export",
        "round-1/push/train: 4 of 5 episodes",
        f"check it: rema verify {Path('mine/pushes').absolute()}",
        "note: push.hdf5, demo_1: other rewards than the columns say, which are imported",
    ):
        assert sentence in back.stdout
    printed = json.loads(rema("import", "exported", "--output", "again", "--name", "pushes", "--json").stdout)
    assert not printed["identical"] and len(printed["differences"]) == 4 and len(printed["notes"]) == 1
    assert printed["sha256"] in back.stdout
    assert printed["original"] == {"release": "tiny", "sha256": release.manifest.sha256}
    assert printed["counts"]["episodes"] == 5


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("export", "nothing", "--output", "out"), "'nothing' is neither a published release nor a folder"),
        (("export",), "Missing option '--output'"),
        (("export", "{release}", "--output", "out", "--task", "grasp_push"), "has no task grasp_push"),
        (("export", "{release}", "--output", "out", "--task", "lift"), "'lift' is not one of"),
        (("export", "{release}", "--output", "out", "--format", "csv"), "unknown format 'csv'"),
        (("export", "{release}", "--output", "out", "--maps", "feet"), "'feet' is not one of"),
        (("import",), "Missing argument"),
        (("import", "nothing"), "there is no file nothing"),
        (("import", "{release}"), "it has no HDF5 file, and no"),
        (("import", "{release}/manifest.json", "--output", "x"), "it is not an HDF5 file"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(words: tuple[str, ...], sentence: str, release: ReleaseFolder) -> None:
    result = rema(*(word.replace("{release}", str(release.path)) for word in words))
    assert result.exit_code == (6 if "not an HDF5" in sentence else 2)
    assert sentence in result.stderr
    assert "Traceback" not in result.stderr
    assert not Path("out").exists()
