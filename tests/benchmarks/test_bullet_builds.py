"""The comparison of builds of Bullet: a build agrees with itself, another outcome is counted, the page is made."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from benchmarks import bullet_builds
from rema_data.schema import TASKS


def compare(monkeypatch: pytest.MonkeyPatch, file: Path) -> tuple[int, dict[str, Any]]:
    words = ["benchmarks/bullet_builds.py", "--episodes", "2", "--against", sys.executable, "--json", str(file)]
    monkeypatch.setattr(sys, "argv", words)
    code = bullet_builds.main()
    return code, json.loads(file.read_text())


@pytest.mark.benchmark
def test_an_interpreter_agrees_with_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code, content = compare(monkeypatch, tmp_path / "builds.json")
    assert code == 0 and list(content["numbers"]["differences"].values()) == [0]


def test_a_difference_is_counted_and_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def hashes(build: str, last: str) -> dict[str, Any]:
        return {"python": "3", "build": build, "tasks": {task: ["a", last] for task in TASKS}}

    monkeypatch.setattr(bullet_builds, "hashes", lambda outcomes: hashes("one", "b"))
    monkeypatch.setattr(bullet_builds, "hashes_of", lambda interpreter, outcomes: hashes("other", "c"))
    code, content = compare(monkeypatch, tmp_path / "builds.json")
    assert code == 6 and content["numbers"]["differences"] == {"other, Python 3": len(TASKS)}


def test_the_page_is_made_from_the_committed_result() -> None:
    text = bullet_builds.PAGE.read_text(encoding="utf-8")
    assert bullet_builds.page(text) == text
