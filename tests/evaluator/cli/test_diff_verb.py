"""``rema diff``: text, JSON and exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from evaluator.cli.main import cli
from rema_data.errors import IntegrityError
from rema_data.release.folder import ReleaseFolder
from rema_data.store.block import STEPS, BlockKey
from rema_data.testing import make_release
from tests.rema_data.verify.damage import change_cell, copy

KEY = BlockKey(1, "grasp", "train")


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    return make_release(tmp_path_factory.mktemp("data"), tasks=("grasp",), episodes=6)


def diff(*words: str | Path) -> Result:
    return CliRunner().invoke(cli, ["diff", *map(str, words)])


def test_equal_releases(release: ReleaseFolder, tmp_path: Path) -> None:
    result = diff(release.path, copy(release, tmp_path).path)
    assert result.exit_code == 0 and result.stdout.splitlines()[-1] == "2 blocks are equal"


def test_releases_that_differ(release: ReleaseFolder, tmp_path: Path) -> None:
    changed = change_cell(copy(release, tmp_path), KEY, STEPS, "lift_m", 2, 0.5)
    result = diff(release.path, changed.path)
    assert result.exit_code == IntegrityError.exit_code
    lines = [line.split() for line in result.stdout.splitlines()]
    assert [KEY.path, "changed", "6", "6", "6", "6"] in lines
    assert [KEY.path, "steps", "0", "0", "1", "lift_m", "1"] in lines
    printed = diff(release.path, changed.path, "--json")
    assert printed.exit_code == IntegrityError.exit_code
    assert json.loads(printed.stdout)["blocks"][0]["tables"][0]["changed"] == 1


def test_a_release_that_is_not_here(release: ReleaseFolder) -> None:
    result = diff(release.path, "nothing")
    assert result.exit_code == 2 and "neither a published release nor a folder" in result.stderr
