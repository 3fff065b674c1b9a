"""The ways of training a better policy differ where they say so, and the whole of it runs, in a reduced size."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from baselines.rounds.recursion_plan import load_recursion
from baselines.tae.network import Architecture
from baselines.train.config import TrainingConfig
from benchmarks import fine
from rema_data.testing import make_release
from rema_data.validation import plain, validated
from tests.benchmarks.test_benchmarks import ROOT

JOINT = [network for network in load_recursion(fine.PLAN).rounds[-1].networks if network.folder == fine.FOLDER]


@pytest.mark.parametrize("name", fine.WAYS)
def test_every_way_differs_from_the_plan_where_it_says_so(name: str) -> None:
    way = fine.WAYS[name]
    for network in JOINT:
        config = way.config(network)
        assert validated(TrainingConfig, json.loads(json.dumps(plain(config))), "a card") == config
        changed = {key for key, value in plain(config).items() if value != plain(network.config)[key]}
        own = {**way.changes, **way.by_primitive.get(network.config.primitive, {})}
        assert changed == {*own, *(("updates",) if way.longer > 1 else ())}
        assert config.updates == way.longer * network.config.updates
        cells = (config.architecture.scene_stride, config.architecture.ee_stride)
        assert cells == ((4, 4) if name == fine.PLANNED else (2, 2))
    assert way.against in fine.WAYS


def test_scenarios_are_grouped_by_target_and_by_tool() -> None:
    found = fine.groups("grasp_push", 100)
    assert {one.by for one in found} == {"shape", "width", "tool"}
    for by in ("shape", "width", "tool"):
        assert sum(one.members.sum() for one in found if one.by == by) == 100
    assert {one.by for one in fine.groups("grasp_grasp", 100)} == {"shape", "width"}


def run(monkeypatch: pytest.MonkeyPatch, folder: Path, *words: str) -> int:
    own = ["--output", str(folder / "out"), "--plan", str(ROOT / "examples" / "tiny.toml")]
    own += ["--releases", str(folder), "--ways", "as-planned,fine", "--episodes", "2"]
    monkeypatch.setattr(sys, "argv", ["fine.py", *own, *words])
    return fine.main()


@pytest.mark.benchmark
def test_trained_scored_and_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(fine, "GOALS", {"grasp_push": 0.95})
    make_release(tmp_path, "tiny-recursion", ("grasp", "push", "grasp_grasp", "grasp_push"), episodes=40)
    assert run(monkeypatch, tmp_path, "--train", "1/2") == 0
    with pytest.raises(SystemExit):
        run(monkeypatch, tmp_path)
    assert "not trained yet: as-planned/push, fine/push" in capsys.readouterr().err
    assert run(monkeypatch, tmp_path, "--train", "2/2") == 0
    assert run(monkeypatch, tmp_path, "--json", str(tmp_path / "fine.json")) == 0
    numbers = json.loads((tmp_path / "fine.json").read_text())["numbers"]["ways"]
    assert set(numbers) == {"as-planned", "fine"}
    assert set(numbers["fine"]["difference"]) == {"grasp_push"}
    shapes = [Architecture.from_dict(card["architecture"]) for card in numbers["fine"]["cards"]]
    assert [(one.width, one.scene_stride, one.ee_stride) for one in shapes] == [(8, 2, 2)] * 2
    assert "what each change gives" in capsys.readouterr().out
