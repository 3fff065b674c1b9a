"""Every benchmark runs, in a reduced size, and writes a result that becomes a section of the page."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from evaluator.scenarios import VERSION

ROOT = Path(__file__).resolve().parents[2]
_LIMIT_S = 1800
"""For what hangs: a script takes minutes at most, and more on a busy machine."""


def run(script: str, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a script of ``benchmarks`` as a reader would."""
    command = [sys.executable, f"benchmarks/{script}.py", *words]
    return subprocess.run(
        command, cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True, timeout=_LIMIT_S
    )


def measured(tmp_path: Path, script: str, *words: str, **environment: str) -> dict[str, Any]:
    """Content of a script's result file, after it ended well."""
    file = tmp_path / f"{script}.json"
    done = run(script, *words, "--json", str(file), **environment)
    assert done.returncode == 0, done.stderr
    content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    assert content["benchmark"] == script
    assert "--json" not in content["command"]
    return content


def page(tmp_path: Path) -> str:
    output = tmp_path / "performance.md"
    done = run("report", "--results", str(tmp_path), "--output", str(output))
    assert done.returncode == 0, done.stderr
    return output.read_text(encoding="utf-8")


@pytest.mark.benchmark
def test_same_cases_have_the_same_outcomes_under_other_histories(tmp_path: Path) -> None:
    words = ("--episodes", "3", "--others", "4", "--tasks", "grasp,grasp_push")
    content = measured(tmp_path, "determinism", *words)
    assert content["numbers"]["cases"] == 18
    assert all(found["differences"] == 0 for found in content["numbers"]["histories"].values())
    assert "## Determinism of the world" in page(tmp_path)


@pytest.mark.benchmark
def test_the_shortcut_is_compared_with_simulation(tmp_path: Path) -> None:
    content = measured(tmp_path, "shortcuts", "--episodes", "40", "--tasks", "grasp,push", "--workers", "1")
    assert content["numbers"]["grasp random shortcut"] > 0
    assert content["targets"][0]["reached"]


@pytest.mark.benchmark
def test_an_entry_is_verified_and_timed(tmp_path: Path) -> None:
    content = measured(tmp_path, "verify_entry", "--episodes", "40", "--policy", "random", "--workers", "1")
    assert content["numbers"]["verified_s"] > 0


def test_speed_and_its_page(tmp_path: Path) -> None:
    words = ("--tasks", "grasp,push", "--episodes", "4", "--repeats", "1", "--plain", "0")
    content = measured(tmp_path, "sim_throughput", *words)
    for row in content["numbers"]["tasks"].values():
        assert 0 < row["stepping_share"] < 1
        assert row["episodes_per_second"] > 0
    text = page(tmp_path)
    assert "python benchmarks/sim_throughput.py" in text
    assert content["machine"]["pybullet"] in text


@pytest.mark.benchmark
def test_noisy_observations_are_the_frozen_ones(tmp_path: Path) -> None:
    content = measured(tmp_path, "noise", "--tasks", "push", "--count", "12", "--repeats", "1")
    rows = content["numbers"]["axes"]
    assert rows["push sense"]["observations_per_second"] > 0
    assert all(row["other_maps"] == 0 for row in rows.values())
    assert "## Observations with the noise of a camera" in page(tmp_path)


@pytest.mark.benchmark
def test_memory(tmp_path: Path) -> None:
    content = measured(
        tmp_path, "memory", "--episodes", "20", "--engine-episodes", "60", "--release", "rema-sample", "--updates", "2"
    )
    assert content["numbers"]["two_workers_mb"] > 0
    assert 0 < content["numbers"]["training_mb"] < content["numbers"]["training_resident_mb"]


@pytest.mark.benchmark
def test_isolation_is_measured(tmp_path: Path) -> None:
    content = measured(tmp_path, "isolation", "--episodes", "64", "--distinct", "16", "--repeats", "1")
    assert content["targets"]


def test_hostile_policies_are_tabled(tmp_path: Path) -> None:
    content = measured(tmp_path, "hostile", "SetsClock", "Exits")
    assert set(content["numbers"]["policies"]) == {"SetsClock", "Exits"}
    assert all(one["counted"] for one in content["numbers"]["policies"].values())


@pytest.mark.benchmark
def test_a_page_is_written_and_measured(tmp_path: Path) -> None:
    words = ("--task", "push", "--episodes", "20", "--per-label", "0", "--repeats", "1")
    content = measured(tmp_path, "report_page", *words)
    assert content["targets"][0]["reached"] and content["numbers"]["bytes"] > 10_000


@pytest.mark.benchmark
def test_browsing_is_measured(tmp_path: Path) -> None:
    content = measured(tmp_path, "view", "--release", "rema-sample", "--repeats", "2")
    assert content["numbers"]["episodes"] == 1200 and content["numbers"]["requests_s"]["a map"] > 0


def test_no_results_are_an_answer_and_no_traceback(tmp_path: Path) -> None:
    done = run("report", "--results", str(tmp_path), "--output", str(tmp_path / "page.md"))
    assert done.returncode == 2
    assert "python benchmarks/sim_throughput.py" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_the_plain_recipe_agrees_on_most_grasps(tmp_path: Path) -> None:
    words = ("--tasks", "grasp", "--episodes", "4", "--repeats", "1", "--plain", "12")
    plain = measured(tmp_path, "sim_throughput", *words)["numbers"]["plain"]
    assert plain["episodes"] == 12
    assert plain["success_flips"] <= 4
    assert plain["ratio"] > 5


@pytest.mark.slow
def test_a_whole_run_against_bare_stepping(tmp_path: Path) -> None:
    environment = {"REMA_MANIFESTS": str(tmp_path / "manifests"), "REMA_HOME": str(tmp_path / "home")}
    (tmp_path / "manifests").mkdir()
    words = ("scenarios", VERSION, "--task", "grasp", "--test", "60", "--val", "5")
    command = [sys.executable, "-m", "evaluator.cli", *words]
    subprocess.run(
        command, cwd=ROOT, env={**os.environ, **environment}, check=True, capture_output=True, timeout=_LIMIT_S
    )
    words = ("--tasks", "grasp", "--policies", "scripted", "--episodes", "60", "--sample", "20")
    (found,) = measured(tmp_path, "full_run", *words, **environment)["numbers"]["runs"]
    assert found["episodes"] == 60
    assert found["ratio"] > 1
    assert "## Whole runs" in page(tmp_path)


@pytest.mark.slow
def test_the_shortcut_agrees_with_simulation_on_two_thousand_episodes(tmp_path: Path) -> None:
    """2,000 cases of every task; any label that differs ends the script with 6."""
    found = subprocess.run(
        [sys.executable, "benchmarks/shortcuts.py", "--episodes", "2000"], cwd=ROOT, capture_output=True, text=True
    )
    assert found.returncode == 0, found.stdout + found.stderr


def test_the_committed_pages_are_made_from_the_committed_results(tmp_path: Path) -> None:
    """No number of the two pages is typed: the scripts write the same pages again."""
    committed = (ROOT / "docs" / "performance.md").read_text(encoding="utf-8")
    done = run("report", "--output", str(tmp_path / "performance.md"))
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "performance.md").read_text(encoding="utf-8") == committed
    copy = tmp_path / "calibration.md"
    copy.write_text((ROOT / "docs" / "calibration.md").read_text(encoding="utf-8"), encoding="utf-8")
    done = run("calibration_report", "--page", str(copy))
    assert done.returncode == 0, done.stderr
    assert copy.read_text(encoding="utf-8") == (ROOT / "docs" / "calibration.md").read_text(encoding="utf-8")


@pytest.mark.benchmark
def test_formats_there_and_back(tmp_path: Path) -> None:
    content = measured(tmp_path, "formats", "--release", "rema-sample", "--task", "push")
    assert {"hdf5", "lerobot", "minari", "rlds", "hf"} <= content["numbers"].keys()
    assert all(found["import"]["differences"] == 0 for found in content["numbers"].values())
    assert content["targets"][0]["reached"]
    assert "## Exports and imports" in page(tmp_path)
