"""The page as text: markup, style and script in one file, and data that the script reads.

A content security policy lets no script run but the page's own, and lets it ask nobody but its own server; the script
writes what comes from files as text, never as markup.
"""

from __future__ import annotations

import json
from typing import Any

from evaluator.render.inlined import csp_hash, text_of
from evaluator.view.viewer import Viewer

__all__ = ["assemble", "served_page"]

_ROOM = "evaluator.view"
_SCRIPTS = ("ask.js", "list.js", "episode.js", "start.js")
"""In this order: what is asked and how, the list with its filters, the episode that is open, keys and the beginning."""


def served_page(viewer: Viewer) -> bytes:
    """The page of a server: it asks for rows, episodes and pictures."""
    return assemble({"about": viewer.about(), "recorded": None}, "connect-src 'self'; img-src 'self' data:")


def assemble(data: Any, sources: str) -> bytes:
    """The page with its data; ``sources`` are what its content security policy allows besides style and script."""
    style, script = text_of(_ROOM, "page.css"), "\n\n".join(text_of(_ROOM, name) for name in _SCRIPTS)
    # No text in it can end the element that holds it, whatever it says.
    inside = json.dumps(data, allow_nan=False).replace("<", "\\u003c")
    policy = f"default-src 'none'; {sources}; style-src '{csp_hash(style)}'; script-src '{csp_hash(script)}'"
    page = text_of(_ROOM, "page.html")
    for mark, text in (("POLICY", policy), ("STYLE", style), ("SCRIPT", script), ("DATA", inside)):
        page = page.replace(f"{{{{{mark}}}}}", text, 1)
    return page.encode()
