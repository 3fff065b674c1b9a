"""Which changes of the code make a work folder another collection's: those of the world and the policies alone."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[3]
IDENTITY = """
import json, sys
from pathlib import Path
from baselines.rounds.collect import _Collection
from baselines.rounds.plan import load_plan
from evaluator.runner import default_backend
from rema_data.progress import Silent
plan = load_plan(Path("examples/collect_plan.toml"))
print(json.dumps(_Collection(plan, Path("out"), Silent(), default_backend(), 250).work_identity()))
"""


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the code, to be changed."""
    folder = tmp_path_factory.mktemp("checkout")
    for name in ("rema_data", "evaluator", "baselines", "manifests", "examples"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.safetensors"))
    return folder


def identity(checkout: Path) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-c", IDENTITY],
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": str(checkout), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.mark.parametrize(
    ("files", "field"),
    [
        (("evaluator/render/studio.py", "evaluator/cli/main.py", "evaluator/report/gallery.py"), None),
        (("evaluator/sim/world.py",), "code"),
        (("baselines/random_policy.py",), "blocks"),
    ],
)
def test_what_a_changed_module_changes(checkout: Path, files: tuple[str, ...], field: str | None) -> None:
    before = identity(checkout)
    for name in files:
        with (checkout / name).open("a") as file:
            file.write("\nCHANGED = True\n")
    after = identity(checkout)
    assert [name for name in before if before[name] != after[name]] == ([] if field is None else [field])
