"""Frozen lists: how they are drawn, and that the ones that ship keep their promises."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from evaluator.cli.main import cli
from evaluator.engines.child import process_pool
from evaluator.policy import resolve
from evaluator.protocol import SCENARIOS
from evaluator.rollout.picks import open_picker
from evaluator.scenarios import SPLITS, VERSION, load_list, manifest_path
from evaluator.scenarios.generation import ROOT_SEED, write_lists
from evaluator.sim.parameters import WORLD
from evaluator.sim.spawn import draw_episode, episode_generator
from rema_data.errors import InputError, IntegrityError, PolicyFailureError
from rema_data.repair import restore
from rema_data.schema import TASKS, pinch_step, tool_steps


@pytest.fixture
def manifests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path))
    return tmp_path


def draw(version: str, tasks: tuple[str, ...], counts: dict[str, int], workers: int = 1, **options: Any) -> Path:
    with process_pool(workers) as pool:
        return write_lists(version, pool, tasks, counts, **options)


def test_lists_do_not_depend_on_the_number_of_workers(manifests: Path) -> None:
    small = {"test": 3, "val": 1}
    for version, workers in (("a", 1), ("b", 2)):
        draw(version, ("grasp_push", "grasp_grasp"), small, workers)
    digests = []
    for version in ("a", "b"):
        content = json.loads(manifest_path(version).read_text())
        digests.append({name: entry["sha256"] for name, entry in content["lists"].items()})
    assert digests[0] == digests[1]
    assert len(digests[0]) == 4
    drawn = load_list("grasp_grasp", version="a").scenarios
    assert [len(scenario.grips) for scenario in drawn] == [2, 2, 2]


def test_a_list_is_never_changed(manifests: Path) -> None:
    path = draw("a", ("grasp",), {"test": 2, "val": 1}, 1)
    before = (path.parent / "grasp_test.parquet").read_bytes()
    draw("a", ("grasp",), {"test": 5, "val": 1}, 1)
    assert (path.parent / "grasp_test.parquet").read_bytes() == before
    with pytest.raises(InputError, match="at least one"):
        draw("c", ("grasp",), {"test": 0, "val": 1})


def test_a_list_that_no_manifest_names_is_drawn_again(manifests: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As after a kill between the list and its manifest."""

    def killed(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("evaluator.scenarios.generation.update_manifest", killed)
        with pytest.raises(KeyboardInterrupt):
            draw("a", ("grasp",), {"test": 2, "val": 1}, 1)
    left = manifest_path("a").with_name("grasp_test.parquet")
    assert left.exists() and not manifest_path("a").exists()
    left.write_bytes(b"of another count, or half a list")
    draw("a", ("grasp",), {"test": 2, "val": 1}, 1)
    assert len(load_list("grasp", version="a").scenarios) == 2 and len(load_list("grasp", "val", "a").scenarios) == 1


def test_a_deleted_list_is_only_restored_with_the_same_bytes(manifests: Path) -> None:
    path = draw("a", ("grasp",), {"test": 2, "val": 1}, 1)
    file = path.with_name("grasp_test.parquet")
    before, named = file.read_bytes(), path.read_bytes()
    file.unlink()
    with pytest.raises(IntegrityError, match="grasp_test.parquet, which is gone") as caught:
        draw("a", ("grasp",), {"test": 3, "val": 1}, 1)
    assert restore(file) in caught.value.hint and not file.exists() and path.read_bytes() == named
    draw("a", ("grasp",), {"test": 2, "val": 1}, 1)
    assert file.read_bytes() == before and path.read_bytes() == named
    path.write_text("{")
    with pytest.raises(IntegrityError, match="cannot be read"):
        draw("a", ("grasp",), {"test": 2, "val": 1}, 1)


def test_a_list_is_named_where_it_lies(manifests: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also when the present version only names the list of an older one."""
    draw("old", ("push",), {"test": 2, "val": 1}, 1)
    with open_picker(resolve("random"), None, "cpu", tmp_path / "log", 1) as picker:
        for present, new in (("old", "middle"), ("middle", "new")):
            monkeypatch.setattr("evaluator.scenarios.lists.VERSION", present)
            draw(new, ("push",), {"test": 9, "val": 9}, 1, picker=picker)
    lists = [json.loads(manifest_path(version).read_text())["lists"] for version in ("middle", "new")]
    assert lists[0] == lists[1] and lists[1]["push/test"]["file"] == "../old/push_test.parquet"
    assert load_list("push", version="new").scenarios == load_list("push", version="old").scenarios


def test_output_of_a_picker_does_not_change_the_lists(
    manifests: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    code = tmp_path / "pickers.py"
    code.write_text(PICKERS)
    draw(VERSION, ("push",), {"test": 2, "val": 1}, 1)
    arguments = ["scenarios", "a", "--task", "push", "--workers", "1", "--test", "1", "--val", "1"]
    done = CliRunner().invoke(cli, [*arguments, "--picker", f"{code}:Chatty"])
    assert done.exit_code == 0, done.output
    assert "the picker is here" in (tmp_path / "home" / "logs" / "scenarios-a.log").read_text()
    assert not list((tmp_path / "scenarios").rglob("*.log"))


def test_a_list_can_be_kept(manifests: Path) -> None:
    """A version may draw new lists for some tasks and name the present lists of others."""
    draw(VERSION, ("grasp", "push"), {"test": 2, "val": 1}, 1)
    path = draw("a", ("grasp",), {"test": 3, "val": 1}, 1, keep=("push",))
    entries = json.loads(path.read_text())["lists"]
    assert entries["push/test"]["file"] == f"../{VERSION}/push_test.parquet"
    assert len(load_list("grasp", version="a").scenarios) == 3
    assert load_list("push", version="a").scenarios == load_list("push").scenarios


PICKERS = """
class Clumsy:
    \"\"\"Right of the middle of what it sees, which is at times a good place.\"\"\"
    def __init__(self, checkpoint, device): ...
    def act(self, observations):
        picks = []
        for scene in observations.scene:
            rows, columns = scene.nonzero()
            picks.append((min(max(int(rows.mean()), 4), 59), min(max(int(columns.mean()), 4), 59), 4))
        return picks

class Chatty(Clumsy):
    def __init__(self, checkpoint, device):
        print("the picker is here")

class Hopeless(Clumsy):
    def act(self, observations):
        return [(4, 4, 0)] * len(observations.scene)
"""


def test_tools_that_a_policy_picked(manifests: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With any number of workers; objects that it cannot pick are drawn again, and the manifest names the policy."""
    code = tmp_path / "pickers.py"
    code.write_text(PICKERS)
    draw(VERSION, ("push",), {"test": 2, "val": 1}, 1)
    listed = []
    for version, workers in (("a", 1), ("b", 2)):
        with open_picker(resolve(f"{code}:Clumsy"), None, "cpu", tmp_path / "log", workers) as picker:
            draw(version, ("grasp_push", "push"), {"test": 3, "val": 1}, workers, picker=picker)
        listed.append(json.loads(manifest_path(version).read_text())["lists"])
    assert listed[0] == listed[1]
    entry = listed[0]["grasp_push/test"]
    assert entry["picker"] == "pickers-Clumsy" and len(entry["picker_digest"]) == 64
    assert sum(item["redrawn"] for item in listed[0].values()) > 0
    for scenario in load_list("grasp_push", version="a").scenarios:
        assert len(scenario.grips) == 1 and scenario.grips[0].spec == scenario.placements[0].spec
    assert (
        listed[0]["push/test"]["file"] == f"../{VERSION}/push_test.parquet"
    )  # no tools: the list of the present version
    assert load_list("push", version="a").scenarios == load_list("push", version=VERSION).scenarios

    monkeypatch.setattr("evaluator.scenarios.policy_picks.LIMIT", 2)
    with (
        open_picker(resolve(f"{code}:Hopeless"), None, "cpu", tmp_path / "log", 1) as picker,
        pytest.raises(PolicyFailureError, match="failed on 2 objects in a row"),
    ):
        draw("c", ("grasp_push",), {"test": 2, "val": 1}, 1, picker=picker)


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("split", SPLITS)
def test_the_shipped_lists(task: str, split: str) -> None:
    frozen = load_list(task, split)
    assert frozen.version == VERSION
    assert len(frozen.scenarios) == SCENARIOS[split]
    for scenario in frozen.scenarios:
        assert len(scenario.placements) == len(TASKS[task])
        assert len(scenario.grips) == len(tool_steps(task))
        assert (scenario.pinch is not None) == (pinch_step(task) is not None)
    entry = json.loads(manifest_path(VERSION).read_text())["lists"][f"{task}/{split}"]
    assert entry["seed_domain"] == f"{ROOT_SEED}/{split}"


@pytest.mark.parametrize("task", TASKS)
def test_no_scene_is_in_two_domains(task: str) -> None:
    test, val = ({scenario.placements for scenario in load_list(task, split).scenarios} for split in SPLITS)
    assert len(test) == SCENARIOS["test"]
    assert not test & val
    collected = {draw_episode(episode_generator(ROOT_SEED, "collect", task, n), task, WORLD) for n in range(1000)}
    calibrated = {draw_episode(episode_generator(ROOT_SEED, "calibrate", task, n), task, WORLD) for n in range(1000)}
    for drawn in (collected, calibrated):
        assert not drawn & (test | val)
        assert not {placements[-1] for placements in drawn} & {placements[-1] for placements in test | val}
