"""Folders of releases on web servers: one streamed request a file, from the byte where the last one stopped."""

from __future__ import annotations

import base64
import netrc
import os
import re
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property, partial
from http import HTTPStatus
from pathlib import Path
from urllib.parse import SplitResult, quote, unquote, urljoin, urlsplit, urlunsplit
from urllib.request import getproxies, proxy_bypass

import urllib3
from urllib3.exceptions import ProtocolError, ProxyError

from rema_data.download.failures import Faltered, Refused, answered
from rema_data.download.labels import label
from rema_data.storage import absolute

__all__ = ["WebFolder"]

Response = urllib3.BaseHTTPResponse
Failure = Refused | Faltered

_CHUNK = 1 << 19
_TIMEOUT = urllib3.Timeout(connect=10.0, read=30.0)
"""A server that sends nothing for so long has dropped the connection."""
_CONNECTIONS = 64
"""Of one server that are kept for the next file: as many as the largest number of jobs."""
_REDIRECTS = 10
_SHORT = 1 << 16
"""The answer beside a redirect is read when it is no longer, so that the connection can be kept."""
_RANGE = re.compile(r"bytes (\d+)-\d+/(\d+|\*)")


class WebFolder:
    """A folder of releases on a web server, which alone gets user and password of the URL. Threads share it.

    ``authorization`` goes to that server in their place; ``refusal`` says what its answers from 400 on mean.
    """

    def __init__(self, url: str, authorization: str = "", refusal: Callable[[Response], Failure] | None = None) -> None:
        self._url = urlsplit(url)
        self._authorization = authorization
        self._refusal = refusal or _refusal
        self._managers: dict[str, urllib3.PoolManager] = {}
        self._lock = threading.Lock()

    def check(self) -> None:
        """Raise ValueError, without a secret in it, where the URL cannot be one."""
        try:
            _ = self._url.port
        except ValueError:
            raise ValueError("its port is not a number") from None
        if not self._url.hostname:
            raise ValueError("it names no host")

    @contextmanager
    def open(self, location: str, start: int, size: int) -> Iterator[tuple[int, Callable[[int], bytes]]]:
        """As ``Source.open``; errors of the connection are those of urllib3."""
        self.check()
        response = self._ask(location, start)
        try:
            if response.status >= HTTPStatus.BAD_REQUEST:
                raise self._refusal(response)
            first = _first_byte(response, location, start, size)
            encoding = _encoding(response)
            # Some servers send what they store compressed, though they are asked not to.
            if encoding and (first or encoding not in ("gzip", "x-gzip")):
                raise Refused(f"sent it compressed ({encoding})")
            yield first, lambda most: response.read1(min(most, _CHUNK), decode_content=bool(encoding))
        finally:
            response.close()  # a connection whose answer was read to its end has gone back to the pool before

    def close(self) -> None:
        """Close the connections that are kept for the next file."""
        for manager in self._managers.values():
            manager.clear()

    def _ask(self, location: str, start: int) -> urllib3.BaseHTTPResponse:
        """The answer at the end of the redirects, which are followed here: each has a proxy and a login of its own."""
        path = f"{self._url.path.rstrip('/')}/{quote(location)}"
        url = urlunsplit(self._url._replace(netloc=_netloc(self._url), path=path, fragment=""))
        headers = {"User-Agent": "rema"} | ({"Range": f"bytes={start}-"} if start else {})
        for _ in range(_REDIRECTS + 1):
            response = self._get(url, headers)
            target = response.get_redirect_location()
            if not target:
                return response
            response.read1(_SHORT)
            response.close()
            url = urljoin(url, target)
            if urlsplit(url).scheme not in ("http", "https"):
                raise Refused("redirects to something that is not on the web")
        raise Refused(f"redirects more than {_REDIRECTS} times")

    def _get(self, url: str, headers: Mapping[str, str]) -> urllib3.BaseHTTPResponse:
        """The answer to one request. Nothing but a connection that was closed is asked again: mirrors come first."""
        parts = urlsplit(url)
        proxy, manager = self._manager(parts)
        ask = partial(
            manager.request,
            "GET",
            url,
            headers={**headers, **self._login(parts, "Authorization")},
            timeout=_TIMEOUT,
            retries=False,
            redirect=False,
            preload_content=False,
            enforce_content_length=False,
        )
        try:
            try:
                return ask()
            except ProtocolError:  # most often a kept connection that the server has closed meanwhile
                return ask()
        except ProxyError as error:
            name = f"{parts.scheme}_proxy"
            raise Faltered(
                f"was not asked: the proxy {label(proxy)} ({name}) cannot be used: {_cause(error.original_error)}; "
                f"correct or unset {name}, or name the host in no_proxy"
            ) from error

    def _manager(self, parts: SplitResult) -> tuple[str, urllib3.PoolManager]:
        """The proxy that the environment names for a server, or none, and the connections through it."""
        proxy = getproxies().get(parts.scheme, "")
        if proxy_bypass(_netloc(parts)):
            proxy = ""
        if proxy and "://" not in proxy:
            proxy = f"http://{proxy}"
        if proxy and not proxy.startswith(("http://", "https://")):
            raise Refused(f"a proxy of the kind {proxy.partition(':')[0]}:// cannot be used, only http:// or https://")
        with self._lock:
            if proxy not in self._managers:
                self._managers[proxy] = (
                    urllib3.ProxyManager(
                        proxy,
                        maxsize=_CONNECTIONS,
                        proxy_headers=self._login(urlsplit(proxy), "Proxy-Authorization"),
                    )
                    if proxy
                    else urllib3.PoolManager(maxsize=_CONNECTIONS)
                )
            return proxy, self._managers[proxy]

    @cached_property
    def _netrc(self) -> netrc.netrc | None:
        path = Path(os.environ.get("NETRC") or f"~/{'_netrc' if os.name == 'nt' else '.netrc'}")
        try:
            return netrc.netrc(absolute(path))
        except (OSError, UnicodeDecodeError, netrc.NetrcParseError):  # as if there were none
            return None

    def _login(self, parts: SplitResult, header: str) -> dict[str, str]:
        """User and password for a URL: its own, those of the source's URL (same server), or those of ``.netrc``."""
        if parts.username is None and (parts.scheme, _netloc(parts)) == (self._url.scheme, _netloc(self._url)):
            if self._authorization:
                return {header: self._authorization}
            parts = self._url
        found = None if self._netrc is None else self._netrc.authenticators(parts.hostname or "")
        if parts.username is not None:
            words = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
        elif found is not None:
            words = f"{found[0]}:{found[2] or ''}"
        else:
            return {}
        return {header: f"Basic {base64.b64encode(words.encode()).decode()}"}


def _refusal(response: Response) -> Failure:
    return answered(response.status, response.reason or "", response.headers.get("Retry-After", ""))


def _cause(error: BaseException) -> str:
    """Why a proxy did not do its work, in the words of the system, which hold no address."""
    while error.__cause__ is not None:
        error = error.__cause__
    return getattr(error, "strerror", None) or (str(error) if type(error) is OSError else type(error).__name__)


def _netloc(parts: SplitResult) -> str:
    """Host and port of a URL, as they stand in it."""
    return parts.netloc.rpartition("@")[2]


def _encoding(response: urllib3.BaseHTTPResponse) -> str:
    """How the body is compressed; empty where it is not."""
    encoding = str(response.headers.get("Content-Encoding", "")).strip().lower()
    return "" if encoding == "identity" else encoding


def _first_byte(response: urllib3.BaseHTTPResponse, location: str, start: int, size: int) -> int:
    """Offset at which a response begins; Refused or Faltered where it cannot be the file."""
    status, headers = response.status, response.headers
    if status == HTTPStatus.PARTIAL_CONTENT:
        match = _RANGE.match(headers.get("Content-Range", ""))
        if match is None or int(match[1]) != start:
            raise Refused(f"sent another range than the one from byte {start:,}")
        if match[2] not in ("*", str(size)):
            raise Refused(f"has {int(match[2]):,} bytes there, expected {size:,}")
        return start
    if status != HTTPStatus.OK:
        raise Refused(f"answered {status} {response.reason}")
    kind = headers.get("Content-Type", "").partition(";")[0].strip()
    length = response.length_remaining
    if length not in (None, size) and not _encoding(response):
        raise Refused(f"sent {length:,} bytes{f' of {kind}' if kind else ''}, expected {size:,}")
    if kind == "text/html" and not location.endswith((".html", ".htm")):
        raise Refused("sent a web page in its place")
    return 0
