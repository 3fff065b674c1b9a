"""The page as text: one template, its style and its script, everything inside the file.

All words of a run are escaped by the template, and a content security policy lets no script run but the page's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jinja2 import Environment, StrictUndefined

from evaluator.render.inlined import csp_hash, rema_version, text_of
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
    style, script = (text_of("evaluator.report", name) for name in ("page.css", "page.js"))
    own = {"style": style, "script": script, "style_hash": csp_hash(style), "script_hash": csp_hash(script)}
    helpers = {
        "share_of": lambda share: f"{100 * share:.2f}%",  # a length in a drawing
        "interval": lambda low, high: f"[{format_interval((low, high))}]",
        "version": rema_version(),
    }
    return environment.from_string(text_of("evaluator.report", "page.html.j2")).render({**content, **own, **helpers})
