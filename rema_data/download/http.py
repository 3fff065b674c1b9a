"""Folders of releases on web servers: one streamed request a file, from the byte where the last one stopped.

The bytes go from the socket into the buffers of the file without another copy: a library that hands out bytes of its
own takes half of the speed.
"""

from __future__ import annotations

import gzip
import io
import re
import string
from collections.abc import Callable
from http import HTTPStatus
from typing import Protocol
from urllib.parse import quote, urljoin, urlsplit, urlunsplit

from rema_data.download.connections import Connections, Reply
from rema_data.download.stream import Refused, Stream, answered

__all__ = ["Closing", "WebFolder"]

_CHUNK = 1 << 19
_MOVED = {
    HTTPStatus.MOVED_PERMANENTLY,
    HTTPStatus.FOUND,
    HTTPStatus.SEE_OTHER,
    HTTPStatus.TEMPORARY_REDIRECT,
    HTTPStatus.PERMANENT_REDIRECT,
}
_REDIRECTS = 10
_SHORT = 1 << 16
"""The answer beside a redirect is read when it is no longer, so that the connection can be kept."""
_RANGE = re.compile(r"bytes (\d+)-\d+/(\d+|\*)")


class Closing(Protocol):
    """Whatever has to be closed."""

    def close(self) -> None:
        """Close it."""
        ...


class WebFolder:
    """A folder of releases behind a URL of HTTP. Threads share it.

    Parameters
    ----------
    url : str
    """

    def __init__(self, url: str) -> None:
        self._url = url
        self._connections = Connections(url)

    def check(self) -> None:
        """Raise where the URL cannot be one.

        Raises
        ------
        ValueError
            Its words hold no secret.
        """
        parts = urlsplit(self._url)
        try:
            _ = parts.port
        except ValueError:
            raise ValueError("its port is no number") from None
        if not parts.hostname:
            raise ValueError("it names no host")

    def open(
        self, location: str, start: int, size: int, judge: Callable[[Exception], Exception]
    ) -> tuple[Closing, Stream]:
        """A file from byte ``start`` on, or from its first byte where the server ignores ranges.

        Raises
        ------
        Refused, Faltered
            By the answer of the server.
        OSError, HTTPException, ValueError
            By the connection.
        """
        self.check()
        reply = self._ask(location, start)
        try:
            response = reply.response
            if response.status >= HTTPStatus.BAD_REQUEST:
                raise answered(response.status, response.reason, response.headers.get("Retry-After"))
            first = _first_byte(reply, location, start, size)
            readinto = _unpacked(reply, first)
        except BaseException:
            reply.close()
            raise
        return reply, Stream(first, _CHUNK, readinto, judge)

    def close(self) -> None:
        """Close the connections that are kept for the next file."""
        self._connections.close()

    def _ask(self, location: str, start: int) -> Reply:
        """The answer at the end of the redirects."""
        parts = urlsplit(self._url)
        netloc = parts.netloc.rpartition("@")[2]
        url = urlunsplit((parts.scheme, netloc, f"{parts.path.rstrip('/')}/{quote(location)}", parts.query, ""))
        headers = {"Range": f"bytes={start}-"} if start else {}
        for _ in range(_REDIRECTS + 1):
            reply = self._connections.get(url, headers)
            target = reply.response.headers.get("Location")
            if reply.response.status not in _MOVED or target is None:
                return reply
            try:
                if reply.response.length is not None and reply.response.length <= _SHORT:
                    reply.response.read()
            finally:
                reply.close()
            url = urljoin(url, quote(target, encoding="iso-8859-1", safe=string.punctuation))
            if urlsplit(url).scheme not in ("http", "https"):
                raise Refused("redirects to something that is not on the web")
        raise Refused(f"redirects more than {_REDIRECTS} times")


def _first_byte(reply: Reply, location: str, start: int, size: int) -> int:
    """Offset at which a response begins; Refused where it cannot be the file."""
    status, headers = reply.response.status, reply.response.headers
    kind = headers.get("Content-Type", "").partition(";")[0].strip()
    if status == HTTPStatus.PARTIAL_CONTENT:
        match = _RANGE.match(headers.get("Content-Range", ""))
        if match is None or int(match[1]) != start:
            raise Refused(f"sent another range than the one from byte {start:,}")
        if match[2] not in ("*", str(size)):
            raise Refused(f"has {int(match[2]):,} bytes there, expected {size:,}")
        return start
    if status != HTTPStatus.OK:
        raise Refused(f"answered {status} {reply.response.reason}")
    length = reply.response.length
    if length not in (None, size) and _encoding(reply) == "identity":
        raise Refused(f"sent {length:,} bytes{f' of {kind}' if kind else ''}, expected {size:,}")
    if kind == "text/html" and not location.endswith((".html", ".htm")):
        raise Refused("sent a web page in its place")
    return 0


def _encoding(reply: Reply) -> str:
    return str(reply.response.headers.get("Content-Encoding", "identity")).strip().lower()


def _unpacked(reply: Reply, first: int) -> Callable[[memoryview], int]:
    """What reads the body. Some servers send what they store packed, though they are asked not to."""
    encoding = _encoding(reply)
    if encoding == "identity":
        return reply.readinto
    if encoding in ("gzip", "x-gzip") and not first:
        return gzip.GzipFile(fileobj=io.BufferedReader(reply.response)).readinto1
    raise Refused(f"sent it packed ({encoding})")
