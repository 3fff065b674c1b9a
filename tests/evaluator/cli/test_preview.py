"""``rema preview``: a picture for every task, and clear refusals."""

from __future__ import annotations

import builtins
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from PIL import Image

from evaluator.cli.main import cli
from evaluator.render.preview import HEIGHT, WIDTH
from evaluator.scenarios import VERSION, update_manifest, write_list
from evaluator.sim.footprints import inner_extents
from evaluator.sim.shapes import boxes
from rema_data.schema import TASKS, Grip, ObjectSpec, Pinch, Placement, Scenario, Shape

BAR = ObjectSpec(Shape.I, 0.10, 0.03, 0.0, 0.03)
ELL = ObjectSpec(Shape.L, 0.11, 0.03, 0.09, 0.03)
STICK = ObjectSpec(Shape.I, 0.19, 0.025, 0.0, 0.03)


def scenario(task: str, index: int) -> Scenario:
    """Scenario 0 has its tools; scenario 1 is one whose tools could not be picked."""
    placement = Placement(ELL, 0.01, 0.02, 0.3)
    placements = (placement,) * len(TASKS[task])
    grips: tuple[Grip, ...] = ()
    pinch = None
    if index == 0 and task == "grasp_push":
        grips = (Grip(BAR, 0.0, 0.0, 0.010, math.pi / 2, 0.03),)
    elif index == 0 and task.startswith("grasp_grasp"):
        grips = (Grip(STICK, 0.0, 0.0, 0.010, math.pi / 2, 0.025),) * 2
    if index == 0 and task == "grasp_grasp_push":
        bar = boxes(BAR)[0]
        left, right = (extent + BAR.width_m / 2 for extent in inner_extents(grips))
        pinch = Pinch(BAR, bar.y, -bar.x, 0.010, math.pi / 2, left, right)
    return Scenario(task, "test", index, placements, grips, pinch)


@pytest.fixture
def lists(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "manifests" / "scenarios" / VERSION
    for task in TASKS:
        file = f"{task}_test.parquet"
        sha256 = write_list(folder / file, [scenario(task, index) for index in range(2)])
        update_manifest(
            folder / "manifest.json", VERSION, f"{task}/test", file=file, sha256=sha256, count=2, seed_domain="test"
        )
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def preview(task: str, number: int, *more: str) -> Result:
    return CliRunner().invoke(cli, ["preview", "--task", task, "--scenario", str(number), *more])


@pytest.mark.parametrize("task", TASKS)
def test_every_task_has_a_picture(task: str, lists: Path) -> None:
    result = preview(task, 0, "--action", "34,20,4", "--json")
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert printed["step"] == len(TASKS[task]) - 1
    assert isinstance(printed["outcome"]["success"], bool)
    path = lists / printed["file"]
    assert path.name == f"preview-{task}-0.png"
    with Image.open(path) as picture:
        assert picture.size == (WIDTH, HEIGHT)
        assert len(picture.convert("RGB").getcolors(1 << 20) or []) > 100
    assert path.stat().st_size < 400_000


def test_a_policy_acts_and_only_the_command_is_heard(lists: Path) -> None:
    command = [sys.executable, "-m", "evaluator.cli", "preview", "--task", "push", "--scenario", "0"]
    root = Path(__file__).resolve().parents[3]
    done = subprocess.run(
        [*command, "--policy", "random", "--protocol", "end-to-end", "--output", str(lists / "a" / "b.png"), "--json"],
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["step"] == 0 and "build time" not in done.stderr
    assert (lists / "a" / "b.png").is_file()


@pytest.mark.parametrize(
    ("task", "number", "more", "sentence"),
    [
        ("grasp", 2, (), "there is no scenario 2 in the test list of grasp"),
        ("grasp", -1, (), "-1 is not in the range"),
        ("grasp", 0, ("--split", "val"), "no 'val' list"),
        ("grasp_push", 1, (), "could not pick up the tools of scenario 1"),
        ("grasp", 0, ("--action", "1,2"), "'1,2' is not an action"),
        ("grasp", 0, ("--action", "a,b,c"), "'a,b,c' is not an action"),
        ("grasp", 0, ("--action", "64,0,0"), "off the grid"),
        ("grasp", 0, ("--action", "0,0,0"), "no arm can carry out action 0,0,0"),
        ("grasp_grasp", 0, ("--action", "32,32,12"), "no arm can carry out action 32,32,12"),
        ("grasp", 0, ("--action", "32,32,0", "--policy", "random"), "takes the place of a policy"),
        ("grasp", 0, ("--policy", "nobody"), "no policy is called 'nobody'"),
        ("grasp", 0, ("--policy", "missing.py"), "missing.py does not exist"),
        ("grasp", 0, ("--action", "32,32,0", "--output", "a.jpg"), "a.jpg is not a PNG file"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(
    task: str, number: int, more: tuple[str, ...], sentence: str, lists: Path
) -> None:
    result = preview(task, number, *more)
    assert result.exit_code == 2
    assert sentence in result.stderr
    assert "Traceback" not in result.stderr
    assert not list(lists.glob("*.png"))


def test_without_pillow_the_extra_is_named(lists: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any, **named: Any) -> Any:
        if name.startswith(("PIL", "matplotlib")):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    result = preview("grasp", 0, "--action", "32,32,0")
    assert result.exit_code == 2
    assert 'pip install "rema[report]"' in result.stderr
