"""What the README promises: its main job, its verbs, and that an installed wheel needs nothing else."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from evaluator.cli.main import VERBS

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def rema(*arguments: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "evaluator.cli", *arguments],
        cwd=cwd,
        env={**os.environ, "REMA_HOME": str(cwd / "home"), **environment},
        capture_output=True,
        text=True,
        timeout=180,
    )


def test_the_main_job(tmp_path: Path) -> None:
    """The README's command, with fewer episodes."""
    command = re.search(r"rema (evaluate examples/my_policy\.py --task grasp_push) --episodes 200", README)
    assert command
    words = command.group(1).replace("examples", str(ROOT / "examples")).split()
    done = rema(*words, "--episodes", "12", "--json", "--output", "run", cwd=tmp_path, PYTHONPATH=str(ROOT))
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["eligible"] == summary["episodes"] == 12
    assert {"run.json", "results.parquet", "timings.parquet", "summary.json"} <= {
        path.name for path in (tmp_path / "run").iterdir()
    }
    table = rema("leaderboard", "run", cwd=tmp_path, PYTHONPATH=str(ROOT))
    assert table.returncode == 0, table.stderr
    assert "my_policy" in table.stdout
    assert "published" in table.stdout


def test_the_training_loop_runs_as_written(tmp_path: Path) -> None:
    """Where nothing is published yet but the bundled sample: the newest release is far larger, and decoded first."""
    published = tmp_path / "manifests" / "datasets"
    shutil.copytree(ROOT / "manifests", published.parent)
    index = json.loads((published / "index.json").read_text())
    rows = [row for row in index["releases"] if row["name"] == "rema-sample"]
    (published / "index.json").write_text(json.dumps({"releases": rows}))
    loop = re.search(r"```python\n(import torch.*?)```", README, flags=re.DOTALL)
    assert loop
    script = tmp_path / "loop.py"
    # Spawned workers import the script again: the guard is what a user's own file would have.
    body = "".join(f"    {line}\n" for line in loop.group(1).splitlines())
    body += "    print(len(sampler), tuple(maps.end_effector.shape))\n"
    script.write_text(f"def main():\n{body}\nif __name__ == '__main__':\n    main()\n")
    done = subprocess.run(
        [sys.executable, str(script)],
        cwd=tmp_path,
        env={
            **os.environ,
            "REMA_HOME": str(tmp_path / "home"),
            "REMA_MANIFESTS": str(published.parent),
            "PYTHONPATH": str(ROOT),
        },
        capture_output=True,
        text=True,
        timeout=180,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split(maxsplit=1)[1].strip() == "(8, 4, 112, 112)"


def test_every_verb_of_the_readme_exists() -> None:
    named = set(re.findall(r"^rema (\w+)", README, flags=re.MULTILINE)) | set(re.findall(r"&& rema (\w+)", README))
    assert named
    assert named <= set(VERBS)


def test_links_of_the_docs_lead_somewhere() -> None:
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        for link in re.findall(r"\]\((?!https?://|#)([^)#]+)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).exists(), f"{page.name} links to {link}"


def test_the_sdist_has_what_the_wheel_is_made_of() -> None:
    build = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]["targets"]
    included = {path.strip("/") for path in build["sdist"]["include"]}
    assert {*build["wheel"]["packages"], *build["wheel"]["force-include"], "hatch_build.py", "LICENSE"} <= included


def test_the_wheel_carries_everything(tmp_path: Path) -> None:
    """Unpacked into an empty folder, the wheel scores a built-in policy on the frozen lists, and knows its commit."""
    pytest.importorskip("hatchling", reason="building a wheel needs hatchling, part of the extra `test`")
    source = tmp_path / "source"
    ignore = shutil.ignore_patterns(".git", "runs", "__pycache__", ".*_cache", ".hypothesis", "docs", "benchmarks")
    shutil.copytree(ROOT, source, ignore=ignore)
    who = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    for words in (["init", "-q"], ["add", "pyproject.toml"], [*who, "commit", "-q", "-m", "x"]):
        subprocess.run(["git", *words], cwd=source, check=True)
    command = ["git", "rev-parse", "HEAD"]
    commit = subprocess.run(command, cwd=source, check=True, capture_output=True, text=True).stdout.strip()
    build = subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path / "dist"), str(source)],
        capture_output=True,
        text=True,
    )
    assert build.returncode == 0, build.stderr
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    site, empty = tmp_path / "site", tmp_path / "empty"
    empty.mkdir()
    zipfile.ZipFile(wheel).extractall(site)
    shutil.rmtree(source)
    environment = {"PYTHONPATH": str(site)}
    done = rema("evaluate", "random", "--task", "grasp", "--episodes", "5", "--json", cwd=empty, **environment)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["eligible"] == 5
    (segment,) = json.loads((empty / "runs" / "random-grasp-conditional" / "run.json").read_text())["segments"]
    assert (segment["commit"], segment["dirty"]) == (commit, False)
