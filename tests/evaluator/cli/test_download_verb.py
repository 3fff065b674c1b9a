"""`rema download`: what it prints, and with which code it ends."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from evaluator.cli.main import cli
from rema_data.release.registry import register
from rema_data.testing import make_release


@pytest.fixture
def mirror(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the published release ``tiny``, on a machine that has nothing of it."""
    (tmp_path / "manifests" / "datasets").mkdir(parents=True)
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.delenv("REMA_OFFLINE", raising=False)
    monkeypatch.chdir(tmp_path)
    register(make_release(tmp_path / "mirror", episodes=2).manifest)
    return tmp_path / "mirror"


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["download", *map(str, arguments)], prog_name="rema")


def test_a_release_in_parts(mirror: Path, tmp_path: Path) -> None:
    plan = run("--dry-run", "--task", "grasp", "--source", mirror)
    assert plan.exit_code == 0, plan.stderr
    assert "round-1/grasp/train" in plan.stdout and "push" not in plan.stdout
    assert f"sources, in order: {mirror}" in plan.stdout and "would be fetched" in plan.stdout
    assert not (tmp_path / "home").exists()

    result = run("--task", "grasp", "--source", mirror)
    assert result.exit_code == 0, result.stderr
    assert "files (" in result.stdout and f"from {mirror}" in result.stdout
    assert result.stdout.splitlines()[-1] == str(tmp_path / "home" / "releases" / "tiny")
    assert "download:" in result.stderr and "download:" not in result.stdout

    again = run("--task", "grasp").stdout
    assert "nothing to fetch" in again and "with the right sizes; --verify rehashes them" in again
    assert "nothing to fetch" in (checked := run("--task", "grasp", "--verify").stdout) and "rehashed" in checked
    assert "here" in run("--dry-run", "--source", mirror).stdout
    report = json.loads(run("tiny", "--json", "--source", mirror).stdout)
    assert (
        report["present_files"] > 0
        and report["fetched_files"] > 0
        and report["sources"] == {str(mirror): report["fetched_files"]}
    )


def test_bad_input(mirror: Path, tmp_path: Path) -> None:
    result = run("huge")
    assert result.exit_code == 2 and "there is no published release 'huge'" in result.stderr
    assert run("--task", "fly").exit_code == run("--jobs", "0").exit_code == 2
    result = run("--round", "7", "--source", mirror)
    assert result.exit_code == 2 and "has no round 7" in result.stderr
    result = run("--offline", "--source", "https://127.0.0.1:9")
    assert result.exit_code == 2 and "--source FOLDER" in result.stderr and "Traceback" not in result.stderr
    file = mirror / "tiny" / "round-1" / "grasp" / "train" / "steps.parquet"
    file.chmod(0o644)
    file.write_bytes(bytes(file.stat().st_size))
    result = run("--source", mirror)
    assert result.exit_code == 6 and "sent other bytes than the release has" in result.stderr


def test_a_release_that_is_not_published(mirror: Path, tmp_path: Path) -> None:
    (tmp_path / "manifests" / "datasets" / "index.json").write_text('{"releases": []}')
    assert run("tiny", "--source", mirror).exit_code == 2
    result = run("--manifest", mirror / "tiny" / "manifest.json", "--source", mirror)
    assert result.exit_code == 0, result.stderr
    assert (tmp_path / "home" / "releases" / "tiny" / "manifest.json").is_file()
