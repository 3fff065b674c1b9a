"""The numbers of docs/scaling.md come from a result file, and say so where there is none."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "scaling.md"


def filled(tmp_path: Path, *words: str) -> str:
    """The page after the report script."""
    page = tmp_path / "scaling.md"
    page.write_text(PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    command = [sys.executable, "benchmarks/scaling_report.py", "--page", str(page), *words]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=120)
    return page.read_text(encoding="utf-8")


def run(engine: str, workers: int, episodes: int, **seconds: float) -> dict[str, Any]:
    names = ("observe_s", "infer_s", "simulate_s", "total_s", "simulator_s", "evaluator_s")
    fields = dict.fromkeys(names, 0.0)
    return {"engine": engine, "workers": workers, "episodes": episodes, "sha256": "d", **fields, **seconds}


def test_the_committed_page_is_made_from_the_committed_result(tmp_path: Path) -> None:
    assert filled(tmp_path) == PAGE.read_text(encoding="utf-8")


def test_without_a_result_the_page_says_how_to_get_one(tmp_path: Path) -> None:
    text = filled(tmp_path, "--result", str(tmp_path / "nothing.json"))
    assert text.count("Not measured yet: `python benchmarks/scaling.py") == 2


def test_ten_million_episodes_follow_from_the_cost_of_one(tmp_path: Path) -> None:
    """1 ms in the simulator, 0.2 ms before it and 0.1 ms after it, whatever a run costs at its start."""
    runs = [run("process", 1, 2000, infer_s=3.4, simulate_s=5.0, total_s=9.6, simulator_s=4.0, evaluator_s=1.0)]
    small = [run("process", 1, 1000, infer_s=3.2, simulate_s=4.0, total_s=8.3, simulator_s=3.0, evaluator_s=0.5)]
    content = {
        "command": "python benchmarks/scaling.py",
        "machine": {"cpu": "a processor", "cores": 2, "load_average": 0.1},
        "tables": [{"title": "runs", "header": ["engine"], "rows": [["process"]]}],
        "targets": [{"what": "same bytes", "wanted": "1", "measured": "1", "reached": True}],
        "notes": [],
        "numbers": {"task": "push", "runs": runs, "small": small, "first": runs[0], "merge_s": 2.0},
    }
    (tmp_path / "result.json").write_text(json.dumps(content))
    text = filled(tmp_path, "--result", str(tmp_path / "result.json"))
    assert "in the simulator. It takes the evaluator 0.20 ms to observe and infer, 0.50 ms to hand out" in text
    assert "takes 1.0 ms of a core" in text
    assert "0.10 ms for the tables, and 1.00 ms to merge" in text
    # 10,000 s of a core on 800 cores; 8,000 s of one evaluator; 100 of them, 100,000 episodes each; 10,000 s to merge
    assert "| 8 | 12 s | 2.2 h | 1 min | 2.8 h |" in text
    assert "| engine |" in text and "Same bytes: yes." in text


@pytest.mark.slow
def test_every_engine_writes_the_same_bytes(tmp_path: Path) -> None:
    file = tmp_path / "scaling.json"
    command = [sys.executable, "benchmarks/scaling.py", "--episodes", "192", "--workers", "1,2", "--json", str(file)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=3600)
    numbers = json.loads(file.read_text(encoding="utf-8"))["numbers"]
    assert len({one["sha256"] for one in numbers["runs"]}) == 1
    assert "Same bytes from every run: yes." in filled(tmp_path, "--result", str(file))
