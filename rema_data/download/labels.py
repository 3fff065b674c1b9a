"""The address of a source or a proxy as messages show it: nothing of a user name, a password or a query is in it."""

from __future__ import annotations

import re
from urllib.parse import urlsplit

__all__ = ["has_secret", "hub_address", "label"]

_LOCAL = ("file", "local")
_HUB = re.compile(
    r"hf://datasets/(?P<organisation>\w[\w.-]*)/(?P<name>\w[\w.-]*)"
    r"(@(?P<revision>refs/(pr|convert)/[\w.-]+|[\w%.-]+))?(?P<folder>(/[\w.-]+)*/?)",
    re.ASCII,
)
_TOKEN = re.compile("hf_[A-Za-z0-9]{8}")
"""How tokens of the hub begin: somebody may put one where it does not belong."""


def hub_address(url: str) -> re.Match[str] | None:
    """The parts of the URL of a dataset on the Hugging Face Hub, or of a folder in it; None for other URLs."""
    return None if _TOKEN.search(url) else _HUB.fullmatch(url)


def label(url: str) -> str:
    """Protocol, host and path of a URL, without user, password and query; a path of this machine as it is.

    Where an ``@`` does not belong to a parsed host, a password with other characters may reach anywhere: then only
    protocols and hosts are shown.
    """
    if ("://" not in url and "::" not in url) or hub_address(url):
        return url
    links = url.split("::")
    try:
        open_end = any("@" in _beyond_host(link) for link in links)
        return "::".join(_label(link, open_end) for link in links)
    except ValueError:
        return f"{url.partition('://')[0].rpartition('::')[2]}://..."


def has_secret(url: str) -> bool:
    """Whether a URL may hold a password or a token: what libraries say about it is then not repeated."""
    if url.partition("://")[0] in _LOCAL or hub_address(url):
        return False
    return ("://" in url or "::" in url) and any(c in url for c in "@?#")


def _beyond_host(link: str) -> str:
    return link.partition("://")[2].removeprefix(urlsplit(link).netloc) if "://" in link else link


def _label(link: str, open_end: bool) -> str:
    protocol, separator, rest = link.partition("://")
    if not separator:
        return "..." if open_end else link
    if protocol in _LOCAL:
        return link
    parts = urlsplit(link)
    host = parts.netloc.rpartition("@")[2]
    if open_end:
        return f"{protocol}://{parts.hostname or ''}"
    _ = parts.port  # not a number: part of a password
    return f"{protocol}://{host}{parts.path}" if rest else link
