"""Connections to web servers, with the standard library: kept for the next file, through proxies, with logins."""

from __future__ import annotations

import base64
import netrc
import os
import ssl
import string
import threading
from collections.abc import Mapping
from functools import cached_property
from http.client import BadStatusLine, HTTPConnection, HTTPResponse, HTTPSConnection
from pathlib import Path
from urllib.parse import SplitResult, quote, unquote, urlsplit, urlunsplit
from urllib.request import getproxies, proxy_bypass

__all__ = ["Connections", "Reply"]

_CONNECT_S = 10.0
_SILENCE_S = 30.0
"""A server that sends nothing for so long has dropped the connection."""
_PORTS = {"http": 80, "https": 443}

_Key = tuple[str, str, int, str]


class Reply:
    """What a server answers to one request.

    Attributes
    ----------
    response : HTTPResponse
    """

    def __init__(self, response: HTTPResponse, connection: HTTPConnection, key: _Key, owner: Connections) -> None:
        self.response = response
        self._connection = connection
        self._key = key
        self._owner = owner

    def readinto(self, space: memoryview) -> int:
        """Bytes of the body, as many as are there; 0 at its end."""
        response = self.response
        if response.chunked or response.fp is None:
            return response.readinto1(space)
        # HTTPResponse copies here what its file could put into the buffer at once.
        count = response.fp.readinto1(space if response.length is None else space[: response.length])
        if response.length is not None:
            response.length -= count
        if not count or response.length == 0:
            response.close()
        return count

    def close(self) -> None:
        """Keep the connection where the body was read to its end."""
        whole = self.response.isclosed() and not self.response.length and not self.response.will_close
        self.response.close()
        if whole:
            self._owner.keep(self._key, self._connection)
        else:
            self._connection.close()


class Connections:
    """Connections to the server of a URL and to those that it redirects to. Threads share it.

    Parameters
    ----------
    url : str
        Its user and password are sent to its server, and to no other.
    """

    def __init__(self, url: str) -> None:
        self._own = urlsplit(url)
        self._idle: dict[_Key, list[HTTPConnection]] = {}
        self._lock = threading.Lock()

    def get(self, url: str, headers: Mapping[str, str]) -> Reply:
        """Ask for a URL. Its redirects are not followed.

        Raises
        ------
        OSError, HTTPException, ValueError
        """
        parts = urlsplit(url)
        sent = {"Accept": "*/*", "Accept-Encoding": "identity", "User-Agent": "rema", **headers}
        login = self._login(parts)
        if login:
            sent["Authorization"] = login
        proxy = _proxy(parts)
        target = quote(urlunsplit(("", "", parts.path or "/", parts.query, "")), safe=string.punctuation)
        if proxy is not None and parts.scheme == "http":
            target = f"http://{_netloc(parts)}{target}"
            if login := self._login(proxy):
                sent["Proxy-Authorization"] = login
        key = (
            parts.scheme,
            parts.hostname or "",
            parts.port or _PORTS[parts.scheme],
            "" if proxy is None else proxy.netloc,
        )
        kept = self._kept(key)
        if kept is not None:
            try:
                return self._ask(kept, key, target, sent)
            except (ConnectionError, BadStatusLine):  # the server has closed it meanwhile
                kept.close()
        return self._ask(self._connect(key, proxy), key, target, sent)

    def keep(self, key: _Key, connection: HTTPConnection) -> None:
        """Keep a connection for the next file."""
        with self._lock:
            self._idle.setdefault(key, []).append(connection)

    def close(self) -> None:
        """Close the connections that are kept."""
        with self._lock:
            idle, self._idle = self._idle, {}
        for connections in idle.values():
            for connection in connections:
                connection.close()

    def _kept(self, key: _Key) -> HTTPConnection | None:
        with self._lock:
            connections = self._idle.get(key)
            return connections.pop() if connections else None

    def _ask(self, connection: HTTPConnection, key: _Key, target: str, headers: Mapping[str, str]) -> Reply:
        try:
            connection.request("GET", target, headers=headers)
            return Reply(connection.getresponse(), connection, key, self)
        except BaseException:
            connection.close()
            raise

    def _connect(self, key: _Key, proxy: SplitResult | None) -> HTTPConnection:
        scheme, host, port, _ = key
        first = (host, port) if proxy is None else (proxy.hostname or "", proxy.port or _PORTS["http"])
        connection = HTTPConnection(*first, timeout=_CONNECT_S)
        if scheme == "https":
            connection = HTTPSConnection(*first, timeout=_CONNECT_S, context=self._tls)
            if proxy is not None:
                login = self._login(proxy)
                connection.set_tunnel(host, port, {"Proxy-Authorization": login} if login else {})
        try:
            connection.connect()
            connection.sock.settimeout(_SILENCE_S)
        except BaseException:
            connection.close()
            raise
        return connection

    @cached_property
    def _tls(self) -> ssl.SSLContext:
        return ssl.create_default_context()

    @cached_property
    def _netrc(self) -> netrc.netrc | None:
        path = Path(os.environ.get("NETRC") or f"~/{'_netrc' if os.name == 'nt' else '.netrc'}")
        try:
            return netrc.netrc(path.expanduser())
        except (OSError, RuntimeError, UnicodeDecodeError, netrc.NetrcParseError):  # as if there were none
            return None

    def _login(self, parts: SplitResult) -> str | None:
        """Of a URL: the one in it, or in the source's URL where that is the same server, or in ``.netrc``."""
        if parts.username is None and (parts.scheme, _netloc(parts)) == (self._own.scheme, _netloc(self._own)):
            parts = self._own
        found = None if self._netrc is None else self._netrc.authenticators(parts.hostname or "")
        if parts.username is not None:
            words = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
        elif found is not None:
            words = f"{found[0]}:{found[2] or ''}"
        else:
            return None
        return f"Basic {base64.b64encode(words.encode()).decode()}"


def _netloc(parts: SplitResult) -> str:
    """Host and port of a URL, as they stand in it."""
    return parts.netloc.rpartition("@")[2]


def _proxy(parts: SplitResult) -> SplitResult | None:
    """The proxy that the environment names for a URL."""
    proxy = getproxies().get(parts.scheme)
    if not proxy or proxy_bypass(_netloc(parts)):
        return None
    found = urlsplit(proxy if "://" in proxy else f"http://{proxy}")
    if found.scheme != "http":
        raise ValueError(f"a proxy of the kind {found.scheme}:// cannot be used, only http://")
    return found
