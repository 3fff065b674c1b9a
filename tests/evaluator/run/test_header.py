"""What ``run.json`` tells of the command that made a run."""

from __future__ import annotations

import hashlib
import shlex
from pathlib import Path
from typing import Any

import pytest

from evaluator.cli.evaluate import evaluate
from evaluator.run.header import resume_command
from evaluator.scenarios.lists import VERSION, installed_list, manifest_path, update_manifest
from evaluator.scenarios.seeds import fresh_version
from evaluator.scenarios.table import encode_list
from tests.evaluator.fakes import fake_scenario

CLEAN, _ = installed_list("grasp", "val") or ("", 0)


def test_the_command_that_goes_on_names_the_device_that_was_used() -> None:
    header = {
        "policy": {"name": "tae-joint"},
        "identity": {"task": "grasp", "protocol": "conditional", "split": "val", "scenarios_hash": CLEAN},
        "episodes": 20,
        "segments": [{"number": 1}, {"number": 2, "device": "openvino"}],
    }
    said = "rema evaluate tae-joint --task grasp --protocol conditional --split val"
    assert resume_command(header, Path("runs/mine")) == f"{said} --device openvino --episodes 20 --output runs/mine"
    shard = {"shard": "1/2", "batch_size": 16}
    header["segments"] = [shard, shard]
    assert " --shard 1/2 --batch-size 16 --episodes 20 " in resume_command(header, Path("runs/mine"))
    header["segments"] = [shard, {**shard, "shard": "2/2"}]  # of a merged run, which continues as a whole
    assert resume_command(header, Path("x")) == f"{said} --batch-size 16 --episodes 20 --output x"
    header["segments"] = [{"number": 1}]  # as runs of before this was noted
    assert resume_command(header, Path("runs/mine")) == f"{said} --episodes 20 --output runs/mine"


def test_the_command_that_goes_on_names_the_list(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """That of a suite, or of a fresh list, is not the one in force."""
    monkeypatch.setenv("REMA_HOME", str(tmp_path))
    payload = encode_list([fake_scenario("grasp", index) for index in range(20)])
    fresh, sha256 = manifest_path(fresh_version(7, 20)), hashlib.sha256(payload).hexdigest()
    fresh.parent.mkdir(parents=True)
    update_manifest(fresh, fresh.parent.name, "grasp/test", file="x", sha256=sha256, count=20, seed_domain="fresh 7")
    for version, wanted in ((VERSION, (None, None)), ("hard-v1", ("hard-v1", None)), (fresh.parent.name, (None, 7))):
        listed = installed_list("grasp", "test", version)
        assert listed is not None
        identity = {"task": "grasp", "protocol": "conditional", "split": "test", "scenarios_hash": listed[0]}
        header: dict[str, Any] = {"policy": {"name": "random"}, "identity": identity, "episodes": 20, "segments": []}
        words = shlex.split(resume_command(header, Path("runs/mine")))
        assert words[:2] == ["rema", "evaluate"]
        given = evaluate.make_context("evaluate", words[2:]).params  # as the command line reads it
        assert (given["suite"], given["fresh"], given["episodes"]) == (*wanted, 20)
    header["episodes"] = 8  # a quick run stopped early: its list is named by all of its scenarios
    assert "--fresh 7 --episodes 20" in resume_command(header, Path("runs/mine"))
    header["identity"]["scenarios_hash"] = "0" * 64  # a list that is not here
    assert not {"--suite", "--fresh"} & set(shlex.split(resume_command(header, Path("runs/mine"))))
