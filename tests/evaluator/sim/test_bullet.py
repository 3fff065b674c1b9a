"""The build of Bullet in the fingerprint, and an installation without one."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from evaluator.run.environment import environment
from evaluator.sim.bullet import bullet_version, decisive
from evaluator.sim.fingerprint import fingerprint
from tests.evaluator.runs import write_run

ROOT = Path(__file__).resolve().parents[3]
HIDDEN = """
import json, sys
from importlib.machinery import PathFinder
from importlib.metadata import PackageNotFoundError, version

class WithoutBullet(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.startswith("pybullet") else super().find_spec(name, path, target)

    @classmethod
    def find_distributions(cls, context):
        return () if (context.name or "").startswith("pybullet") else super().find_distributions(context)

sys.meta_path[sys.meta_path.index(PathFinder)] = WithoutBullet
"""
VERBS = """
from click.testing import CliRunner
from evaluator.cli.main import cli
for words in json.loads(sys.argv[1]):
    done = CliRunner().invoke(cli, words)
    print(json.dumps([done.exit_code, done.stderr, repr(done.exception)]))
"""


def without_bullet(code: str, *arguments: str) -> str:
    command = [sys.executable, "-c", HIDDEN + code, *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def pretend(monkeypatch: pytest.MonkeyPatch, **versions: str) -> None:
    def version(name: str) -> str:
        if name not in versions:
            raise metadata.PackageNotFoundError(name)
        return versions[name]

    monkeypatch.setattr("evaluator.sim.bullet.version", version)


def test_the_official_build_is_its_version_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch, pybullet="3.2.7")
    assert bullet_version() == fingerprint()["pybullet"] == environment()["versions"]["pybullet"] == "3.2.7"


def test_the_fork_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch, **{"pybullet-arm64": "3.2.8"})
    assert bullet_version() == fingerprint()["pybullet"] == "pybullet-arm64-3.2.8"
    assert environment()["versions"]["pybullet"] == "pybullet-arm64-3.2.8"


def test_no_build(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch)
    assert bullet_version() is None and "pybullet" not in environment()["versions"]


def test_constants_and_probe_decide_and_the_name_of_the_build_does_not() -> None:
    mark = {"pybullet": "3.2.7", "parameters": "p", "probe": "q"}
    assert decisive(mark) == decisive({**mark, "pybullet": "pybullet-arm64-3.2.8"}) != decisive({**mark, "probe": "r"})
    assert decisive(None) == {}


def test_everything_but_simulation_works_without_bullet(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    runs = [str(write_run(tmp_path / name, rng.random(100) < 0.5, policy=name)) for name in ("a", "b")]
    sample = str(ROOT / "releases" / "rema-sample")
    verbs = [
        ["--help"],
        *([verb, "--help"] for verb in ("download", "train", "evaluate", "collect", "rounds", "replay", "merge")),
        ["stats", sample],
        ["verify", sample],
        ["leaderboard", *runs],
        ["compare", *runs],
    ]
    imports = "import rema_data, evaluator, evaluator.runner.merge, baselines.train.loop\n"
    printed = without_bullet(imports + VERBS, json.dumps(verbs))
    results = [json.loads(line) for line in printed.splitlines()]
    assert [result[0] for result in results] == [0] * len(verbs), results


def test_simulation_says_what_to_install(tmp_path: Path) -> None:
    run = str(write_run(tmp_path / "run", np.ones(100, bool)))
    output = ["--output", str(tmp_path / "new")]
    verbs = [
        ["evaluate", "random", "--task", "grasp", *output],
        ["collect", str(ROOT / "examples" / "collect_plan.toml"), *output],
        ["replay", run],
        ["report", run],
        ["preview", "--scenario", "0", "--task", "grasp", *output],
        ["scenarios", "v9"],
    ]
    for line, words in zip(without_bullet(VERBS, json.dumps(verbs)).splitlines(), verbs, strict=True):
        code, said, error = json.loads(line)
        assert code == 2 and error == "SystemExit(2)", (words, line)
        assert said.startswith("rema: simulation needs PyBullet, which is not installed\npip install "), (words, line)
    assert not (tmp_path / "new").exists()
