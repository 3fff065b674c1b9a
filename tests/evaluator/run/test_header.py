"""What ``run.json`` tells of the command that made a run."""

from __future__ import annotations

from pathlib import Path

from evaluator.run.header import resume_command


def test_the_command_that_goes_on_names_the_device_that_was_used() -> None:
    header = {
        "policy": {"name": "tae-joint"},
        "identity": {"task": "grasp", "protocol": "conditional", "split": "val"},
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
