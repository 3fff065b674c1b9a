"""The documentation site: it has every page and every public name, and its tutorials run."""

from __future__ import annotations

import os
import re
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
API = {
    "rema_data": "rema_data",
    "rema_data.convert": "rema_data",
    "rema_data.diff": "rema_data",
    "rema_data.download": "rema_data",
    "rema_data.publish": "rema_data",
    "rema_data.testing": "rema_data.testing",
    "rema_data.testing.formats": "rema_data.testing",
    "evaluator": "evaluator",
    "evaluator.statistics": "evaluator",
    "evaluator.view": "evaluator",
    "evaluator.policy.contract": "policy",
    "evaluator.testing.engines": "evaluator.testing",
    "evaluator.testing.policies": "evaluator.testing",
}
TUTORIALS = sorted(path.stem for path in (DOCS / "tutorials").glob("*.md"))


def documented(page: str) -> set[str]:
    """Full names in the lists of a page of the API, and those whose documentation stands on it."""
    text = (DOCS / "api" / f"{page}.md").read_text(encoding="utf-8")
    return set(re.findall(r"^(?:   |\.\. auto\w+:: )([a-z_]+(?:\.\w+)+)$", text, re.M))


@pytest.mark.parametrize("module", API)
def test_every_public_name_is_in_the_reference(module: str) -> None:
    offered = import_module(module)
    # the contract of a policy is documented where a submitter imports it from
    prefix = "evaluator.policy" if module == "evaluator.policy.contract" else module
    names = {name for name in offered.__all__ if type(getattr(offered, name)) is not ModuleType}
    assert {f"{prefix}.{name}" for name in names} <= documented(API[module])


@pytest.mark.parametrize("page", sorted(set(API.values())))
def test_every_name_in_the_reference_exists(page: str) -> None:
    for name in documented(page):
        module, _, attribute = name.rpartition(".")
        assert name == "rema_data.errors" or hasattr(import_module(module), attribute), name


def test_every_page_is_in_the_navigation() -> None:
    parts = ("index", "tutorials", "guides", "reference", "explanation")
    texts = "\n".join((DOCS / f"{part}.md").read_text(encoding="utf-8") for part in parts)
    listed = {
        line for block in re.findall(r"```\{toctree\}\n(.*?)```", texts, re.DOTALL) for line in block.splitlines()
    }
    pages = {path.relative_to(DOCS).with_suffix("").as_posix() for path in DOCS.rglob("*.md")}
    assert {page for page in pages if not page.startswith("decisions/0")} - {"index"} <= listed


@pytest.mark.parametrize("name", TUTORIALS)
def test_the_tutorial_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From top to bottom in an empty folder."""
    reason = "tutorials need the extra `docs`"
    read = pytest.importorskip("myst_nb.core.read", reason=reason)
    nbclient = pytest.importorskip("nbclient", reason=reason)
    if "import jax" in (DOCS / "tutorials" / f"{name}.md").read_text(encoding="utf-8"):
        pytest.importorskip("jax", reason=reason)
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("PATH", os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(DOCS.parent), os.environ.get("PYTHONPATH", "")]))
    notebook = read.read_myst_markdown_notebook((DOCS / "tutorials" / f"{name}.md").read_text(encoding="utf-8"))
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert any(cell.get("outputs") for cell in notebook.cells)
