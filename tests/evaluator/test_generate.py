"""Frozen lists: how they are drawn, and that the ones that ship keep their promises."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from evaluator.generate import COUNTS, ROOT_SEED, Picker, write_lists
from evaluator.policy import resolve
from evaluator.scenarios import SPLITS, VERSION, load_list, manifest_path, reference_pinch, reference_tools
from evaluator.sim.parameters import WORLD
from evaluator.sim.spawn import draw_episode, episode_generator
from rema_data.errors import InputError, PolicyFailureError
from rema_data.schema import TASKS


@pytest.fixture
def manifests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path))
    return tmp_path


def test_lists_do_not_depend_on_the_number_of_workers(manifests: Path) -> None:
    small = {"test": 3, "val": 1}
    for version, workers in (("a", 1), ("b", 2)):
        write_lists(version, ("grasp_push", "grasp_grasp"), small, workers)
    digests = []
    for version in ("a", "b"):
        content = json.loads(manifest_path(version).read_text())
        digests.append({name: entry["sha256"] for name, entry in content["lists"].items()})
    assert digests[0] == digests[1]
    assert len(digests[0]) == 4
    drawn = load_list("grasp_grasp", version="a").scenarios
    assert [len(scenario.grips) for scenario in drawn] == [2, 2, 2]


def test_a_list_is_never_changed(manifests: Path) -> None:
    path = write_lists("a", ("grasp",), {"test": 2, "val": 1}, 1)
    before = (path.parent / "grasp_test.parquet").read_bytes()
    write_lists("a", ("grasp",), {"test": 5, "val": 1}, 1)
    assert (path.parent / "grasp_test.parquet").read_bytes() == before
    with pytest.raises(InputError, match="at least one"):
        write_lists("c", ("grasp",), {"test": 0, "val": 1})


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

class Hopeless(Clumsy):
    def act(self, observations):
        return [(4, 4, 0)] * len(observations.scene)
"""


def test_tools_that_a_policy_picked(manifests: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the number of workers; objects that it cannot pick are drawn again, and the manifest says who picked."""
    code = tmp_path / "pickers.py"
    code.write_text(PICKERS)
    picker = Picker(resolve(f"{code}:Clumsy"), None, tmp_path / "log")
    write_lists(VERSION, ("push",), {"test": 2, "val": 1}, 1)
    listed = []
    for version, workers in (("a", 1), ("b", 2)):
        write_lists(version, ("grasp_push", "push"), {"test": 3, "val": 1}, workers, picker=picker)
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

    monkeypatch.setattr("evaluator.picked.LIMIT", 2)
    with pytest.raises(PolicyFailureError, match="failed on 2 objects in a row"):
        write_lists(
            "c",
            ("grasp_push",),
            {"test": 2, "val": 1},
            1,
            picker=Picker(resolve(f"{code}:Hopeless"), None, tmp_path / "log"),
        )


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("split", SPLITS)
def test_the_shipped_lists(task: str, split: str) -> None:
    frozen = load_list(task, split)
    assert frozen.version == VERSION
    assert len(frozen.scenarios) == COUNTS[split]
    for scenario in frozen.scenarios:
        assert len(scenario.placements) == len(TASKS[task])
        assert len(scenario.grips) == reference_tools(task)
        assert (scenario.pinch is not None) == reference_pinch(task)
    entry = json.loads(manifest_path(VERSION).read_text())["lists"][f"{task}/{split}"]
    assert entry["seed_domain"] == f"{ROOT_SEED}/{split}"


@pytest.mark.parametrize("task", TASKS)
def test_no_scene_is_in_two_domains(task: str) -> None:
    test, val = ({scenario.placements for scenario in load_list(task, split).scenarios} for split in SPLITS)
    assert len(test) == COUNTS["test"]
    assert not test & val
    collected = {draw_episode(episode_generator(ROOT_SEED, "collect", task, n), task, WORLD) for n in range(1000)}
    calibrated = {draw_episode(episode_generator(ROOT_SEED, "calibrate", task, n), task, WORLD) for n in range(1000)}
    for drawn in (collected, calibrated):
        assert not drawn & (test | val)
        assert not {placements[-1] for placements in drawn} & {placements[-1] for placements in test | val}
