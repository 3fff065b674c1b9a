"""What a self-contained page is put together from: files of a package, and the hashes of a content security policy."""

from __future__ import annotations

import base64
import hashlib
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files

__all__ = ["csp_hash", "rema_version", "text_of"]


def text_of(package: str, name: str) -> str:
    """A file of a package, without blank ends."""
    return files(package).joinpath(name).read_text(encoding="utf-8").strip()


def csp_hash(text: str) -> str:
    """Of an inline style or script, as a content security policy names it."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def rema_version() -> str:
    """Of the installed rema, in words for a page."""
    try:
        return version("rema")
    except PackageNotFoundError:
        return "of a checkout"
