"""The worked examples of CONTRIBUTING.md: each is carried out as it is written, and its own tests pass.

A code block whose first line is ``# PATH`` is a file. One that begins with ``# PATH, after: LINE`` is put behind that
line of a file of rema, in a copy; with ``instead of:``, in place of it.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def blocks(heading: str) -> list[tuple[str, str]]:
    """First line, without its ``#``, and the rest of every code block below a heading that begins with a comment."""
    section = TEXT.split(f"## {heading}\n", 1)[1].split("\n## ", 1)[0]
    return re.findall(r"```\w+\n# ([^\n]+)\n(.*?)```", section, re.DOTALL)


def python(folder: Path, *words: str) -> None:
    """Run Python in a folder whose modules come before those of rema."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])}
    done = subprocess.run([sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("heading", "some"), [("Add a policy", ""), ("Add an engine", ""), ("Add a format", "out_and_back or not_there")]
)
def test_a_package_of_your_own(heading: str, some: str, tmp_path: Path) -> None:
    """Its files, as if they were installed with their entry points; its tests are those of the example."""
    for name, content in blocks(heading):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(content, encoding="utf-8")
    project = (tmp_path / "pyproject.toml").read_text(encoding="utf-8")
    points = project.replace('project.entry-points."', "").replace('"]', "]").replace('"', "")
    installed = tmp_path / "example-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: example\nVersion: 1.0\n", encoding="utf-8")
    (installed / "entry_points.txt").write_text(points, encoding="utf-8")
    python(tmp_path, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests", *(["-k", some] if some else []))


@pytest.mark.parametrize("heading", ["Add a task", "Add an axis", "Add a column", "Add a failure label"])
def test_a_change_of_rema(heading: str, tmp_path: Path) -> None:
    for package in ("rema_data", "evaluator", "baselines"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("manifests", "releases", "pyproject.toml"):
        (tmp_path / name).symlink_to(ROOT / name)
    for place, content in blocks(heading):
        name, how, line = re.fullmatch(r"(\S+?)(?:, (after|instead of): (.*))?", place).groups()
        path = tmp_path / name
        if how:
            before = path.read_text(encoding="utf-8")
            (found,) = (one for one in before.splitlines(keepends=True) if one.strip() == line)
            content = before.replace(found, (found if how == "after" else "") + content)
        path.write_text(content, encoding="utf-8")
    python(tmp_path, "try_it.py")


def test_every_session_that_is_named_exists() -> None:
    sessions = set(re.findall(r"^def (\w+)\(session", (ROOT / "noxfile.py").read_text(encoding="utf-8"), re.M))
    sessions |= {"py311", "py312", "py313"}
    texts = TEXT + (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    named = {name for names in re.findall(r"nox [^`\n]*?-s ([\w ]+)", texts) for name in names.split()}
    assert {"lint", "types", "imports", "tests", "benchmarks", "docs"} <= named <= sessions
