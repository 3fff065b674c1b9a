"""Where files come from: folders of releases behind a path or a URL, read through fsspec.

HTTP servers are read with one streamed request a file, which starts at the byte where the last one stopped. Everything
else that fsspec opens is read in blocks from that byte on.
"""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit, urlunsplit

from rema_data.errors import InputError

__all__ = ["Faltered", "Refused", "Source", "Stream"]

_CHUNK = 1 << 20
_BUFFER = 1 << 18
"""Of an HTTP connection. What is in it is lost when the connection drops; smaller ones are slower."""
_BLOCK = 2 << 20
"""Bytes of one request to a store that is read in blocks, such as S3. At most so many are lost by a kill."""
_CONNECT_S = 10.0
_SILENCE_S = 30.0
"""A server that sends nothing for so long has dropped the connection."""
_PASSING = {HTTPStatus.REQUEST_TIMEOUT, HTTPStatus.TOO_EARLY, HTTPStatus.TOO_MANY_REQUESTS}
_RANGE = re.compile(r"bytes (\d+)-\d+/(\d+|\*)")
_LONGEST_ANSWER = 200


class Refused(Exception):
    """The source will not deliver this file, however often it is asked.

    Attributes
    ----------
    absent : bool
        It just does not have the file, as a mirror of a part of a release.
    """

    def __init__(self, why: str, *, absent: bool = False) -> None:
        super().__init__(why)
        self.absent = absent


class Faltered(Exception):
    """The source may deliver the file when it is asked again.

    Attributes
    ----------
    wait_s : float
        How long it asks us to wait, s.
    """

    def __init__(self, why: str, wait_s: float = 0.0) -> None:
        super().__init__(why)
        self.wait_s = wait_s


class Stream:
    """Bytes of one file from one source.

    Attributes
    ----------
    start : int
        Offset of the first byte: what was asked for, or 0 where a server ignores ranges.
    """

    def __init__(self, start: int, chunk: int, read: Callable[[int], bytes], judge: Callable[[Exception], Exception]):
        self.start = start
        self._chunk = chunk
        self._read = read
        self._judge = judge

    def read(self, limit: int) -> bytes:
        """The next bytes, at most ``limit``; none at the end.

        Raises
        ------
        Refused, Faltered
        """
        try:
            return self._read(min(limit, self._chunk))
        except Exception as error:
            raise self._judge(error) from error


class Source:
    """A folder of releases: the file ``holder/path`` lies at ``url/holder/path``.

    Parameters
    ----------
    url : str or path
        A folder, or any URL that fsspec opens: ``file://``, ``http(s)://``, ``s3://``, ...

    Attributes
    ----------
    label : str
        The URL without user, password and query.
    local : bool
        A folder of this machine.
    """

    def __init__(self, url: str | os.PathLike[str]) -> None:
        self.url = os.fspath(url).strip()
        if not self.url:
            raise InputError("a source is empty", hint="name a folder or a URL: --source https://host/releases")
        protocol = self.url.partition("://")[0] if "://" in self.url else "file"
        self.local = protocol in ("file", "local") and "::" not in self.url
        self._http = protocol in ("http", "https")
        self.label = _without_secrets(self.url)
        self._lock = threading.Lock()
        self._opened: tuple[Any, str] | None = None

    def __repr__(self) -> str:
        return f"Source({self.label!r})"

    def check(self) -> None:
        """Raise where the URL cannot be one, or a package that reads it is missing.

        Raises
        ------
        InputError
        """
        try:
            self._filesystem()
        except ImportError as error:
            amazon = self.url.startswith(("s3://", "s3a://"))
            package = 'pip install "rema[s3]"' if amazon else str(error)
            raise InputError(
                f"the source {self.label} needs a package that is not installed", hint=package, source=self.label
            ) from error
        except ValueError as error:
            raise InputError(
                f"the source {self.label} cannot be used: {error}",
                hint="name a folder, or a URL that begins with file://, https://, s3:// or another fsspec protocol",
                source=self.label,
            ) from error
        except Exception:  # a server that does not answer now is found out when it is needed
            return

    def folder(self) -> Path | None:
        """The folder of a local source."""
        return Path(self._filesystem()[1]) if self.local else None

    @contextmanager
    def open(self, location: str, start: int, size: int) -> Iterator[Stream]:
        """A file from byte ``start`` on.

        Parameters
        ----------
        location : str
            ``holder/path``.
        start : int
        size : int
            Bytes of the whole file.

        Raises
        ------
        Refused
            It is not there, or has another size, or something else comes in its place.
        Faltered
            The source does not answer now.
        """
        try:
            filesystem, base = self._filesystem()
            if self._http:
                file, stream = self._open_http(filesystem, location, start, size)
            else:
                file, stream = self._open_blocks(filesystem, base, location, start, size)
        except (Refused, Faltered):
            raise
        except TimeoutError as error:
            raise Refused("does not answer") from error
        except Exception as error:
            raise self._judge(error) from error
        try:
            yield stream
        finally:
            file.close()

    def _filesystem(self) -> tuple[Any, str]:
        """The fsspec file system and the path of the source in it."""
        from fsspec.core import url_to_fs

        with self._lock:
            if self._opened is None:
                options = {"client_kwargs": _client_options()} if self._http else {}
                filesystem, path = url_to_fs(self.url, **options)
                self._opened = filesystem, str(path)
            return self._opened

    def _open_http(self, filesystem: Any, location: str, start: int, size: int) -> tuple[Any, Stream]:
        parts = urlsplit(self.url)
        url = urlunsplit(parts._replace(path=f"{parts.path.rstrip('/')}/{quote(location)}"))
        headers = {**(filesystem.kwargs.get("headers") or {}), "Accept-Encoding": "identity"}
        if start:
            headers["Range"] = f"bytes={start}-"
        # With a block size of 0 fsspec streams; the size spares it a request.
        file = filesystem.open(url, "rb", block_size=0, size=size, headers=headers)
        try:
            first = _first_byte(file.r, location, start, size)
        except BaseException:
            file.close()
            raise
        return file, Stream(first, _CHUNK, file.read, self._judge)

    def _open_blocks(self, filesystem: Any, base: str, location: str, start: int, size: int) -> tuple[Any, Stream]:
        path = f"{base.rstrip('/')}/{location}" if base else location
        got = filesystem.size(path)
        if got is not None and got != size:
            raise Refused(f"has {got:,} bytes there, expected {size:,}")
        file = filesystem.open(path, "rb", block_size=_BLOCK, cache_type="none")
        try:
            if start:
                file.seek(start)
        except BaseException:
            file.close()
            raise
        return file, Stream(start, _CHUNK if self.local else _BLOCK, file.read, self._judge)

    def _judge(self, error: Exception) -> Refused | Faltered:
        """What an exception of a file system or of a server means for this file."""
        if isinstance(error, FileNotFoundError | NotADirectoryError):
            folder = self.folder() if self.local else None
            if folder is not None and not folder.is_dir():
                return Refused("there is no such folder", absent=True)
            return Refused("does not have it", absent=True)
        if isinstance(error, IsADirectoryError):
            return Refused("has a folder in its place")
        if isinstance(error, PermissionError):
            return Refused(f"does not allow it ({self._words(error)})")
        if isinstance(error, ImportError):
            return Refused(f"cannot be read here: {self._words(error)}")
        status = getattr(error, "status", None)
        if isinstance(status, int) and status >= HTTPStatus.BAD_REQUEST:
            answer = f"answered {status} {getattr(error, 'message', '')}".strip()
            if status in _PASSING or status >= HTTPStatus.INTERNAL_SERVER_ERROR:
                return Faltered(answer, _retry_after(error))
            return Refused(answer)
        if isinstance(error, TimeoutError):
            return Faltered("sends nothing more")
        return Faltered(self._words(error))

    def _words(self, error: Exception) -> str:
        name = type(error).__name__
        lines = str(error).replace(self.url, self.label).splitlines()
        if not lines:
            return name
        return (lines[0] if isinstance(error, OSError) else f"{name}: {lines[0]}")[:_LONGEST_ANSWER]


def _client_options() -> dict[str, Any]:
    """Of the HTTP session: proxies and ``.netrc`` as the environment has them, no limit on a whole file's time."""
    from aiohttp import ClientTimeout

    timeout = ClientTimeout(total=None, sock_connect=_CONNECT_S, sock_read=_SILENCE_S)
    return {"timeout": timeout, "trust_env": True, "read_bufsize": _BUFFER}


def _without_secrets(url: str) -> str:
    """The URL as messages show it: without user and password, and over HTTP without the query."""
    shown = re.sub(r"(?<=://)[^/@]*@", "", url)
    return re.sub(r"[?#].*", "", shown) if url.startswith(("http://", "https://")) else shown


def _first_byte(response: Any, location: str, start: int, size: int) -> int:
    """Offset at which a response begins; Refused where it cannot be the file."""
    status, headers = response.status, response.headers
    kind = headers.get("Content-Type", "").partition(";")[0].strip()
    if status == HTTPStatus.PARTIAL_CONTENT:
        match = _RANGE.match(headers.get("Content-Range", ""))
        if match is None or int(match[1]) != start:
            raise Refused(f"sent another range than the one from byte {start:,}")
        if match[2] not in ("*", str(size)):
            raise Refused(f"has {int(match[2]):,} bytes there, expected {size:,}")
        return start
    if status != HTTPStatus.OK:
        raise Refused(f"answered {status} {response.reason}")
    length = headers.get("Content-Length", "")
    encoded = headers.get("Content-Encoding", "identity") != "identity"
    if length.isdecimal() and not encoded and int(length) != size:
        raise Refused(f"sent {int(length):,} bytes{f' of {kind}' if kind else ''}, expected {size:,}")
    if kind == "text/html" and not location.endswith((".html", ".htm")):
        raise Refused("sent a web page in its place")
    return 0


def _retry_after(error: Exception) -> float:
    """Seconds that a server asks us to wait; a date counts as none."""
    value = (getattr(error, "headers", None) or {}).get("Retry-After", "")
    return float(value) if value.isdecimal() else 0.0
