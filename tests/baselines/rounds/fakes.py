"""Plans on disk, and the light world of ``tests.evaluator.fakes`` to collect them in."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path
from typing import Any

import pytest

from baselines.rounds.collect import Collected, collect
from baselines.rounds.plan import load_plan
from baselines.rounds.work import work_path
from tests.evaluator.fakes import FakePolicyProcess, fake_backend

PLAN = """
name = "tiny"
title = "Tiny"
description = "For tests."
license = "CC-BY-4.0"
citation = "Nobody."
seed = 7

[[rounds]]
policy = "random"
episodes = { train = 12, val = 3 }
tasks = ["grasp"]

[[rounds]]
policy = "scripted"
picks = "reference"
episodes = { train = 11 }
tasks = ["grasp_grasp_push"]
"""


def write_plan(folder: Path, text: str = PLAN, **changes: str) -> Path:
    """A plan file with some pieces of its text replaced."""
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    path = folder / "plan.toml"
    path.write_text(text)
    return path


def collect_fake(plan: Path, output: Path, engine: str = "inline", **options: Any) -> Collected:
    """Collect in the fake world, five episodes a chunk."""
    options = {"backend": fake_backend(), "chunk_episodes": 5, "workers": 2} | options
    return collect(load_plan(plan), output, engine=engine, **options)


def tree(folder: Path) -> dict[str, str]:
    """sha256 of every file below a folder."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


class _Stopper(FakePolicyProcess):
    """Presses Ctrl-C in the middle of an answer."""

    def __init__(self, after: int) -> None:
        super().__init__()
        self.left = after

    def act(self, batch: Any, situations: Any) -> list[Any]:
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt
        return super().act(batch, situations)


def interrupted(plan: Path, output: Path, after: int, **backend: Any) -> Path:
    """The work folder of a collection that was interrupted after so many answers of its policy."""
    with pytest.raises(KeyboardInterrupt):
        collect_fake(plan, output, backend=fake_backend(_Stopper(after), **backend))
    return work_path(output, "tiny")


def main(plan: str, output: str, engine: str) -> None:
    """A collection in a process of its own, to be killed."""
    collect_fake(Path(plan), Path(output), engine)


if __name__ == "__main__":
    main(*sys.argv[1:])
