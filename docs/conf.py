"""Sphinx configuration of the documentation site: ``nox -s docs`` builds it into ``build/docs/html``."""

from __future__ import annotations

import os
import re
import sys
from importlib import import_module, metadata
from pathlib import Path

from myst_nb.core import render
from nbformat import NotebookNode
from sphinx.application import Sphinx

import evaluator

ROOT = Path(__file__).resolve().parents[1]

project = "rema"
author = "The rema authors"
copyright = f"{author}; code: MIT, data: CC-BY-4.0"
release = version = metadata.version("rema")
language = "en"
smartquotes = False  # they make a dash of --option

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinxcontrib.mermaid",
]
exclude_patterns = ["_static", "_templates"]
templates_path = ["_templates"]
suppress_warnings = ["config.cache"]

# Pages: the Markdown that is also read in the repository.
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 4
myst_fence_as_directive = ["mermaid"]  # as GitHub draws it
pygments_style = "friendly"
copybutton_exclude = ".linenos, .gp, .go"

# Tutorials: run when the site is built, in an empty folder each, and without the user's releases and runs.
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True
nb_output_stderr = "remove"  # progress
os.environ["REMA_HOME"] = str(ROOT / "build" / "docs-home")
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
os.environ["COLUMNS"] = "100"  # of the tables that `rema` prints
os.environ.setdefault("OMP_NUM_THREADS", "1")

# The Python API, from the docstrings.
autosummary_generate = True
autodoc_typehints = "none"  # numpydoc says the types, with shapes and units
autodoc_member_order = "bysource"
numpydoc_show_class_members = False  # the template of a class lists them
numpydoc_class_members_toctree = False
for _name in ("leaderboard", "replay"):  # packages that can be called: the site shows the functions
    import_module(f"evaluator.{_name}")
    setattr(evaluator, _name, getattr(import_module("evaluator.api"), _name))

html_theme = "pydata_sphinx_theme"
html_title = f"rema {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {
    "logo": {"text": "rema"},
    "show_prev_next": False,
    "navigation_with_keys": False,
    "navbar_align": "left",
    "header_links_before_dropdown": 5,
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": ["theme-version"],
    "secondary_sidebar_items": ["page-toc"],
    "back_to_top_button": False,
}
if repository := os.environ.get("GITHUB_REPOSITORY"):  # in a workflow of GitHub
    html_theme_options["github_url"] = f"https://github.com/{repository}"

# Pages of the repository that lie outside of docs/, and their names in the site.
_OUTSIDE = {
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "changes/README.md": "fragments.md",
    "manifests/leaderboard/README.md": "entries.md",
}


def _place_links(app: Sphinx, docname: str, source: list[str]) -> None:
    """Give a page of the table above its content, and lead links of any page to pages of the site."""
    page = Path(app.env.doc2path(docname))
    origin = page
    for name, target in _OUTSIDE.items():
        if page == ROOT / "docs" / target:
            origin = ROOT / name
            source[0] = origin.read_text(encoding="utf-8")
            app.env.note_dependency(str(origin))

    def placed(link: re.Match[str]) -> str:
        place = Path(os.path.normpath(origin.parent / link[1]))
        if not place.exists():
            return link[0]
        if place.is_relative_to(ROOT) and (target := _OUTSIDE.get(place.relative_to(ROOT).as_posix())):
            place = ROOT / "docs" / target
        return f"]({Path(os.path.relpath(place, page.parent)).as_posix()}{link[2] or ''})"

    source[0] = re.sub(r"\]\((?!\w+:|#)([^)#\s]+)(#[^)\s]*)?\)", placed, source[0])


def _whole_streams(outputs: list[NotebookNode]) -> list[NotebookNode]:
    """One text a stream: IPython cuts what %%bash prints every 100 bytes, where MyST-NB would break the line."""
    whole: list[NotebookNode] = []
    streams: dict[str, NotebookNode] = {}
    for output in outputs:
        if output["output_type"] != "stream":
            whole.append(output)
        elif output["name"] in streams:
            streams[output["name"]]["text"] += output["text"]
        else:
            streams[output["name"]] = output
            whole.append(output)
    return whole


def setup(app: Sphinx) -> None:
    """Hook into the build."""
    app.connect("source-read", _place_links)
    render.coalesce_streams = _whole_streams
