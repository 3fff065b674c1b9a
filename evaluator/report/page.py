"""The page as text: one template, its style and its script, everything inside the file.

All words of a run are escaped by the template, and a content security policy lets no script run but the page's own.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from typing import Any

from jinja2 import Environment, StrictUndefined

from evaluator.statistics import format_interval, percent

__all__ = ["render"]


def render(content: Mapping[str, Any]) -> str:
    """The page; ``content`` are the names that the template uses."""
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, keep_trailing_newline=True)
    environment.filters.update(
        percent=lambda share: f"{percent(share)} %",
        count="{:,}".format,
        words=lambda label: str(label).replace("_", " "),
    )
    style, script = _text("page.css"), _text("page.js")
    own = {"style": style, "script": script, "style_hash": _hash(style), "script_hash": _hash(script)}
    helpers = {
        "share_of": lambda share: f"{100 * share:.2f}%",  # a length in a drawing
        "interval": lambda low, high: f"[{format_interval((low, high))}]",
        "version": _version(),
    }
    return environment.from_string(_text("page.html.j2")).render({**content, **own, **helpers})


def _text(name: str) -> str:
    return files("evaluator.report").joinpath(name).read_text(encoding="utf-8").strip()


def _hash(text: str) -> str:
    """Of an inline style or script, as a content security policy names it."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _version() -> str:
    try:
        return version("rema")
    except PackageNotFoundError:
        return "of a checkout"
