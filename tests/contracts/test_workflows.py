"""The workflows: they parse, what they run exists, and a pull request cannot upload or bring its own simulator."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from evaluator.cli.main import VERBS, cli

ROOT = Path(__file__).resolve().parents[2]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
pytestmark = pytest.mark.skipif(not WORKFLOWS, reason="the workflows come with a clone only")
NOXFILE = (ROOT / "noxfile.py").read_text(encoding="utf-8")
SESSIONS = {*re.findall(r"^def (\w+)\(session", NOXFILE, re.MULTILINE), "py311", "py312", "py313"}


def read(name: str) -> dict[Any, Any]:
    content: dict[Any, Any] = yaml.safe_load((ROOT / ".github" / "workflows" / name).read_text(encoding="utf-8"))
    return content


def steps(workflow: dict[Any, Any]) -> Iterator[dict[str, Any]]:
    for job in workflow["jobs"].values():
        yield from job["steps"]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_what_a_workflow_runs_exists(path: Path) -> None:
    workflow = read(path.name)
    assert workflow["permissions"] in ({"contents": "read"}, {})
    for job in workflow["jobs"].values():
        assert job["timeout-minutes"] and job["steps"]
    for step in steps(workflow):
        assert ("run" in step) != ("uses" in step)
        if "uses" in step:
            assert re.fullmatch(r"[\w-]+/[\w-]+@(v\d+|release/v\d+)", step["uses"])
            continue
        # A value from outside that is pasted into a script is a part of the script: it comes in the environment.
        assert not re.search(r"\$\{\{\s*github\.(event|head_ref|ref_name)", step["run"])
        for session in re.findall(r"nox -s ([\w ]+)", step["run"]):
            assert set(session.split()) <= SESSIONS
        for script in re.findall(r"\.ci/[\w-]+", step["run"]):
            assert (ROOT / script).is_file()


def test_scripts_name_verbs_and_options_that_exist() -> None:
    found = re.findall(r"^\s*(?:if )?rema (\w+)((?: (?!2?>)\S+)*)", (ROOT / ".ci" / "verify-entries").read_text(), re.M)
    assert found
    for verb, rest in found:
        assert verb in VERBS
        known = {option for parameter in cli.get_command(None, verb).params for option in parameter.opts}  # type: ignore
        known |= {
            option
            for parameter in cli.get_command(None, verb).params  # type: ignore
            for option in parameter.secondary_opts
        }
        assert {word for word in rest.split() if word.startswith("--")} <= known


def test_only_one_job_may_upload_and_it_runs_no_code_of_ours() -> None:
    workflow = read("release.yml")
    assert workflow[True] == {"push": {"tags": ["v*"]}}  # YAML reads the key `on` as true
    upload = workflow["jobs"]["upload"]
    assert upload["permissions"] == {"id-token": "write"} and upload["environment"] == "pypi"
    assert all("run" not in step for step in upload["steps"])
    assert [name for name, job in workflow["jobs"].items() if "id-token" in job.get("permissions", {})] == ["upload"]


def test_the_code_of_a_pull_request_is_not_run() -> None:
    workflow = read("leaderboard.yml")
    assert set(workflow[True]) == {"pull_request_target"}
    for step in steps(workflow):
        if step.get("uses", "").startswith("actions/checkout"):
            assert "ref" not in step["with"] and step["with"]["persist-credentials"] is False
    assert workflow["jobs"]["simulate"]["permissions"] == {"contents": "read"}
    comment = workflow["jobs"]["comment"]
    assert comment["permissions"] == {"pull-requests": "write"}
    assert not any("checkout" in step.get("uses", "") for step in comment["steps"])


def test_the_tag_of_a_release_is_its_version() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]

    def check(tag: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, ROOT / ".ci" / "check-tag", tag], capture_output=True, text=True)

    assert check(f"v{version}").returncode == 0
    wrong = check("v9.9.9")
    assert wrong.returncode == 1 and f"pyproject.toml says {version}" in wrong.stderr


def test_zenodo_and_the_citation_agree() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    zenodo = json.loads((ROOT / ".zenodo.json").read_text())
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert zenodo["title"] == citation["title"] and citation["version"] == project["version"]
    assert zenodo["license"] == citation["license"] == project["license"]
    assert [creator["name"] for creator in zenodo["creators"]] == [author["name"] for author in citation["authors"]]
    assert zenodo["keywords"] == project["keywords"]
    (paper,) = zenodo["related_identifiers"]
    assert project["urls"]["Paper"].rpartition("/")[2] == paper["identifier"].removeprefix("arXiv:")


REMA = """#!/usr/bin/env bash
if [[ "$*" == *--record* ]]; then
  grep -q good "$2" || { echo "rema: $2 is refused" >&2; exit 6; }
  cp "$2" "manifests/leaderboard/verified/$(basename "$2")"
else
  echo "| policy | ${@: -1} |"
fi
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A repository whose `main` is checked out, with a `rema` that knows good entries by a word in them."""
    if shutil.which("bash") is None:
        pytest.skip("the script is for bash")
    folder = tmp_path / "checkout"
    (folder / ".ci").mkdir(parents=True)
    shutil.copy(ROOT / ".ci" / "verify-entries", folder / ".ci")
    (folder / "manifests" / "leaderboard" / "verified").mkdir(parents=True)
    (folder / "manifests" / "leaderboard" / "verified" / "kept.json").write_text("{}")
    (folder / "simulator.py").write_text("ours")
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "rema").write_text(REMA)
    (tmp_path / "bin" / "rema").chmod(0o755)
    git(folder, "init", "-q", "-b", "main")
    git(folder, "add", ".")
    git(folder, "commit", "-qm", "base")
    return folder


def git(folder: Path, *arguments: str) -> None:
    who = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    subprocess.run(["git", *who, *arguments], cwd=folder, check=True, capture_output=True)


def simulate(checkout: Path, files: dict[str, str], link: str = "") -> tuple[int, str]:
    """Exit code and comment of the script, for a pull request with these files."""
    git(checkout, "checkout", "-qb", "theirs")
    for path, text in files.items():
        (checkout / path).parent.mkdir(parents=True, exist_ok=True)
        (checkout / path).write_text(text)
    if link:
        (checkout / link).symlink_to("/etc/passwd")
    git(checkout, "add", ".")
    git(checkout, "commit", "-qm", "theirs")
    git(checkout, "checkout", "-q", "main")
    path = f"{checkout.parent / 'bin'}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run([".ci/verify-entries", "theirs", "verdict"], cwd=checkout, env={**os.environ, "PATH": path})
    return done.returncode, (checkout / "verdict" / "comment.md").read_text()


BOARD = "manifests/leaderboard"


def test_entries_of_a_pull_request_are_simulated_with_our_code(checkout: Path) -> None:
    code, comment = simulate(checkout, {f"{BOARD}/a.json": "good", "simulator.py": "theirs"})
    assert code == 0 and "`a.json`: simulated" in comment and f"| policy | {BOARD}/a.json |" in comment
    assert (checkout / "verdict" / "verified" / "a.json").read_text() == "good"
    assert (checkout / "simulator.py").read_text() == "ours"


def test_an_entry_that_is_refused_is_named_with_the_reason(checkout: Path) -> None:
    code, comment = simulate(checkout, {f"{BOARD}/a.json": "good", f"{BOARD}/b.json": "bad"})
    assert code == 1 and "`a.json`: simulated" in comment
    assert "`b.json`: refused" in comment and f"rema: {BOARD}/b.json is refused" in comment


@pytest.mark.parametrize("name", ["-rf.json", "a b.json", "$(id).json", "`id`.json"])
def test_odd_names_and_links_are_not_read(checkout: Path, name: str) -> None:
    code, comment = simulate(checkout, {f"{BOARD}/{name}": "good"}, link=f"{BOARD}/link.json")
    assert code == 1 and "no entry that can be read" in comment
    assert not (checkout / BOARD / name).exists() and not (checkout / BOARD / "link.json").exists()


def test_records_of_a_pull_request_are_not_believed(checkout: Path) -> None:
    code, _ = simulate(checkout, {f"{BOARD}/verified/a.json": "forged"})
    assert code == 1 and not (checkout / BOARD / "verified" / "a.json").exists()
