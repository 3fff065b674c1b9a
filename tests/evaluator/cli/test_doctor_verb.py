"""``rema doctor``: tables, JSON, exit code."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from evaluator.cli.main import cli
from rema_data.release.registry import register
from rema_data.testing import make_release


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine with one published release in its home."""
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.setattr("rema_data.doctor.releases.local_sources", tuple)
    monkeypatch.setenv("COLUMNS", "200")
    (tmp_path / "manifests").mkdir()
    register(make_release(tmp_path / "home" / "releases", tasks=("grasp",), episodes=3).manifest)
    return tmp_path


def doctor(*arguments: str) -> Result:
    return CliRunner().invoke(cli, ["doctor", "--seconds", "0.01", *arguments])


def test_all_is_well(machine: Path) -> None:
    result = doctor()
    assert result.exit_code == 0, result.output
    for words in ("pybullet", "==3.2.", f"REMA_HOME is {machine / 'home'} (writable", "published", "2/2", "samples/s"):
        assert words in result.stdout
    assert "nothing is wrong" in result.stdout
    assert "reading tiny" in result.stderr


def test_json_is_alone_on_stdout(machine: Path) -> None:
    printed = json.loads(doctor("--json").stdout)
    assert printed["ok"] and printed["problems"] == []
    assert [release["name"] for release in printed["releases"]] == ["tiny"]
    assert len(printed["speeds"]) == 4


def test_prune(machine: Path) -> None:
    doctor()
    (ready,) = [path for path in (machine / "home" / "decoded").iterdir() if path.is_dir()]
    part = machine / "home" / "releases" / "tiny" / "steps.parquet.part"
    part.touch()
    stale = ready.with_name("0" * 16 + "-" + "0" * 8)
    stale.mkdir()
    result = doctor("--prune")
    assert result.exit_code == 0, result.output
    assert f"deleted {stale} (damaged, 0.0 MB)" in result.stderr
    assert f"deleted {part} (partial" in result.stderr
    assert ready.is_dir() and not stale.exists() and not part.exists()


def test_a_problem_is_exit_code_6(machine: Path) -> None:
    manifest = machine / "home" / "releases" / "tiny" / "manifest.json"
    manifest.chmod(0o644)
    manifest.write_bytes(b"{}")
    result = doctor()
    assert result.exit_code == 6
    assert "problem: " in result.stdout and "nothing is wrong" not in result.stdout


def test_damaged_content_of_a_cache_is_found_when_it_is_asked_for(machine: Path) -> None:
    doctor()
    (cache,) = [path for path in (machine / "home" / "decoded").iterdir() if path.is_dir()]
    assert doctor("--check-caches").exit_code == 0
    with (cache / "index.npy").open("rb+") as file:
        file.seek(-8, 2)
        file.write(b"\xff" * 8)
    assert doctor("--seconds", "0").exit_code == 0
    result = doctor("--check-caches")
    assert result.exit_code == 6
    printed = " ".join(result.stdout.split())
    assert f"the decoded cache {cache} is damaged (index.npy): rema doctor --check-caches --prune" in printed
    assert doctor("--check-caches", "--prune").exit_code == 0 and not cache.exists()
    assert doctor("--check-caches").exit_code == 0 and cache.is_dir()


def test_a_cache_without_checksums_is_no_problem(machine: Path) -> None:
    doctor()
    (record,) = (machine / "home" / "decoded").glob("*/cache.json")
    content = json.loads(record.read_text())
    del content["digests"], content["content_sha256"]  # as an earlier version wrote it
    record.write_text(json.dumps(content))
    assert "cannot be checked" not in doctor().stdout
    result = doctor("--check-caches")
    assert result.exit_code == 0 and f"rm -r '{record.parent}'" in result.stdout
