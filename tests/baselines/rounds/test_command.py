"""``rema collect``: what it prints, and with which exit code it ends."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from baselines.rounds.estimate import estimate
from baselines.rounds.plan import load_plan
from evaluator.cli.main import cli
from rema_data.manifests import manifests_dir
from rema_data.release.folder import find_release
from rema_data.release.registry import published
from tests.baselines.rounds.fakes import collect_fake, write_plan
from tests.evaluator.fakes import FakePolicyProcess, fake_backend


@pytest.fixture(autouse=True)
def light_world(monkeypatch: pytest.MonkeyPatch, quick_fingerprint: None) -> None:
    for module in ("collect", "estimate"):
        monkeypatch.setattr(f"baselines.rounds.{module}.default_backend", fake_backend)


def rema(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["collect", *map(str, arguments)])


def test_it_seals_and_registers_a_release(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "manifests" / "datasets").mkdir(parents=True)
    (tmp_path / "manifests" / "datasets" / "index.json").write_text('{"releases": []}\n')
    (tmp_path / "manifests" / "scenarios").symlink_to(manifests_dir() / "scenarios")
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    arguments = (write_plan(tmp_path), "--output", tmp_path / "releases", "--engine", "inline")
    done = rema(*arguments, "--json")
    assert done.exit_code == 0, done.output
    facts = json.loads(done.stdout)
    manifest = find_release(tmp_path / "releases" / "tiny").manifest
    assert (facts["release"], facts["sha256"], facts["already"]) == ("tiny", manifest.sha256, False)
    assert facts["counts"]["episodes"] == 26 and published() == {}
    again = rema(*arguments, "--register")
    assert again.exit_code == 0 and "was sealed before, by the same plan: 26 episodes" in again.stdout
    assert published() == {"tiny": manifest.sha256}


def test_a_dry_run_leaves_nothing_behind(tmp_path: Path) -> None:
    plan, output = write_plan(tmp_path), tmp_path / "releases"
    shown = rema(plan, "--output", output, "--dry-run")
    assert shown.exit_code == 0, shown.output
    assert "grasp_grasp_push" in shown.stdout and "reference" in shown.stdout and not output.exists()
    facts = json.loads(rema(plan, "--output", output, "--dry-run", "--json").stdout)
    assert [(row["round"], row["task"], row["split"], row["episodes"]) for row in facts["blocks"]] == [
        (1, "grasp", "train", 12),
        (1, "grasp", "val", 3),
        (2, "grasp_grasp_push", "train", 11),
    ]
    assert facts["blocks"][2]["policies"] == ["reference", "reference", "reference", "scripted"]
    assert facts["totals"]["episodes"] == 26
    assert all(row["seconds"] > 0 and row["bytes"] > 0 for row in facts["blocks"])


def test_the_expected_size_is_near_the_size(tmp_path: Path) -> None:
    plan = write_plan(tmp_path, **{"train = 12, val = 3": "train = 150", "train = 11": "train = 60"})
    expected = estimate(load_plan(plan), engine="inline", backend=fake_backend())
    manifest = collect_fake(plan, tmp_path, chunk_episodes=100).release.manifest
    for entry in expected:
        files = [file.bytes for file in manifest.files if file.block == entry.block.key.path]
        assert entry.bytes == pytest.approx(sum(files), rel=0.5)


def test_a_bad_plan_is_bad_input(tmp_path: Path) -> None:
    done = rema(write_plan(tmp_path, **{"seed = 7": ""}), "--output", tmp_path)
    assert done.exit_code == 2 and "seed is missing" in done.stderr
    assert rema(tmp_path / "gone.toml").exit_code == 2
    assert rema(write_plan(tmp_path), "--workers", "0").exit_code == 2
    in_the_way = rema(write_plan(tmp_path), "--output", tmp_path / "plan.toml", "--engine", "inline")
    assert in_the_way.exit_code == 2 and "is a file, not a folder" in in_the_way.stderr


def test_a_policy_that_fails_has_its_exit_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    faulty = fake_backend(FakePolicyProcess(faulty=1.0))
    monkeypatch.setattr("baselines.rounds.collect.default_backend", lambda: faulty)
    done = rema(write_plan(tmp_path), "--output", tmp_path, "--engine", "inline")
    assert done.exit_code == 4 and "policy random gave no action for step 0 of episode 0" in done.stderr
