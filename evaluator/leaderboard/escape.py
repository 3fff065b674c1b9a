"""Text from files, such as the name of a policy, inside documents: it stays text, whatever characters it has."""

from __future__ import annotations

import re
from typing import Any
from urllib.parse import urlsplit

__all__ = ["one_line", "to_csv", "to_latex", "to_markdown", "web_link"]

_BREAKS = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+")
_MARKDOWN = re.compile(r"[\\`*<>|&~]|(?<!\w)_|_(?!\w)|(?<=\])[\[(:]|!(?=\[)")
_BLOCK = re.compile(r"^(#|[-+](?=\s)|\d+(?=[.)]\s))")
"""What begins a heading or a list at the beginning of a line."""
_FORMULA = ("=", "+", "-", "@")
_LATEX = {character: f"\\{character}" for character in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
}


def one_line(text: str) -> str:
    """Without line breaks and other control characters."""
    return _BREAKS.sub(" ", text)


def to_markdown(text: str) -> str:
    """Text that Markdown, and HTML in it, does not interpret."""
    return _BLOCK.sub(r"\\\1", _MARKDOWN.sub(lambda found: f"\\{found[0]}", one_line(text)))


def to_latex(text: str) -> str:
    """Text that LaTeX typesets as it is."""
    return "".join(_LATEX.get(character, character) for character in one_line(text))


def to_csv(value: Any) -> Any:
    """A value that no spreadsheet takes for a formula; numbers stay numbers."""
    if not isinstance(value, str):
        return value
    text = one_line(value)
    return f"'{text}" if text.lstrip().startswith(_FORMULA) else text


def web_link(url: str) -> str:
    """The URL where it leads to a web page, else nothing: not to a script."""
    try:
        parts = urlsplit(url)
    except ValueError:
        return ""
    return url if parts.scheme in ("http", "https") and parts.netloc else ""
