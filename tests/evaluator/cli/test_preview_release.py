"""``rema preview`` of a release: a sheet, a page, a table, and clear refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from PIL import Image

from evaluator.cli.main import cli
from rema_data.release.folder import ReleaseFolder
from rema_data.release.registry import register
from rema_data.testing import make_release


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    return make_release(tmp_path_factory.mktemp("tiny") / "releases", tasks=("grasp", "grasp_push"), episodes=10)


@pytest.fixture(autouse=True)
def place(tiny: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder, and an index in which the release is published."""
    index = tmp_path / "manifests" / "datasets" / "index.json"
    index.parent.mkdir(parents=True)
    index.write_text('{"releases": []}\n')
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.setenv("REMA_HOME", str(tiny.root.parent))
    monkeypatch.chdir(tmp_path)
    register(tiny.manifest)
    return tmp_path


def preview(*arguments: str) -> Result:
    return CliRunner().invoke(cli, ["preview", *arguments])


def test_the_newest_release_without_any_option(place: Path) -> None:
    result = preview()
    assert result.exit_code == 0, result.output
    assert result.stdout == "preview-tiny.png: 12 steps\n"
    with Image.open(place / "preview-tiny.png") as picture:
        assert picture.size[0] > 1000


def test_a_folder_and_an_episode(place: Path, tiny: ReleaseFolder) -> None:
    result = preview(
        *("--release", str(tiny.path), "--task", "grasp_push", "--split", "train", "--round", "1"),
        *("--episode", "0", "--episode", "2", "--output", "a/b.png", "--json"),
    )
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert (printed["release"], printed["file"]) == ("tiny", "a/b.png")
    assert {step["episode"] for step in printed["steps"]} == {0, 2}
    assert {step["task"] for step in printed["steps"]} == {"grasp_push"}
    assert (place / "a" / "b.png").is_file()


def test_a_page(place: Path) -> None:
    result = preview("--task", "grasp", "--count", "3", "--output", "page.html")
    assert result.exit_code == 0, result.output
    assert (place / "page.html").read_text().count("<img ") == 3


@pytest.mark.parametrize(("option", "wins"), [("--success", True), ("--failure=missed", False)])
def test_outcomes(option: str, wins: bool) -> None:
    result = preview(option, "--which", "all", "--table", "--json")
    assert result.exit_code == 0, result.output
    steps = json.loads(result.stdout)["steps"]
    assert {step["success"] for step in steps} == {wins}
    assert {step["failure"] for step in steps} == {None if wins else "missed"}


def test_a_table_draws_nothing(place: Path) -> None:
    result = preview("--task", "grasp_push", "--which", "picks", "--table", "--count", "4")
    assert result.exit_code == 0, result.output
    assert result.stdout.count("grasp_push 1/2") == 4
    assert max(map(len, result.stdout.splitlines())) <= 80
    assert not list(place.glob("*.png"))


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--release", "nothing"), "neither a published release nor a folder"),
        (("--task", "push"), "has no task push"),
        (("--split", "test"), "has no split test"),
        (("--round", "4"), "has no round 4"),
        (("--episode", "99"), "has no such step"),
        (("--failure", "tool_lost"), "has no such step"),
        (("--success", "--failure", "missed"), "has no failure"),
        (("--episode", "1", "--count", "3"), "--episode shows all steps"),
        (("--output", "a.gif"), "neither a PNG nor an HTML file"),
        (("--policy", "random"), "--policy is for scenarios"),
        (("--action", "1,2,3"), "--action is for scenarios"),
        (("--task", "grasp", "--scenario", "0", "--release", "tiny"), "--release is for releases"),
        (("--task", "grasp", "--scenario", "0", "--count", "3"), "--count is for releases"),
        (("--scenario", "0"), "belongs to one task"),
        (("--task", "grasp", "--task", "push", "--scenario", "0"), "belongs to one task"),
        (("--task", "grasp", "--split", "train", "--scenario", "0"), "no training scenarios"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(arguments: tuple[str, ...], sentence: str, place: Path) -> None:
    result = preview(*arguments)
    assert result.exit_code == 2
    assert sentence in result.stderr
    assert "Traceback" not in result.stderr
    assert not list(place.glob("*.png"))
