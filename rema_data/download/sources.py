"""Where files come from: folders of releases behind a path or a URL.

HTTP servers, the Hugging Face Hub among them, are read with one streamed request a file, which starts at the byte where
the last one stopped. Everything else is opened by fsspec and read in blocks from that byte on.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from http import HTTPStatus
from pathlib import Path
from typing import Any

from urllib3.exceptions import HTTPError
from urllib3.exceptions import TimeoutError as WebTimeoutError

from rema_data.download.failures import Faltered, Refused, answered
from rema_data.download.hub import HubFolder
from rema_data.download.labels import has_secret, label
from rema_data.download.web import WebFolder
from rema_data.errors import InputError
from rema_data.repair import install
from rema_data.storage import absolute

__all__ = ["Source"]

_CHUNK = 1 << 20
_BLOCK = 2 << 20
"""Bytes of one request to a store that is read in blocks, such as S3. At most so many are lost by a kill."""
_LONGEST_ANSWER = 200
_TIMEOUTS = (TimeoutError, WebTimeoutError)


def _web_folder(protocol: str, url: str) -> WebFolder | HubFolder | None:
    if protocol == "hf":
        return HubFolder(url)
    return WebFolder(url) if protocol in ("http", "https") else None


class Source:
    """A folder of releases: the file ``holder/path`` lies at ``url/holder/path``.

    ``url`` is a folder, ``hf://datasets/ORG/NAME``, or anything that fsspec opens: ``file://``, ``http(s)://``,
    ``s3://``, ... ``label`` is the URL without user, password and query; ``local`` tells a folder of this machine.
    """

    def __init__(self, url: str | os.PathLike[str]) -> None:
        self.url = os.fspath(url).strip()
        if not self.url:
            raise InputError("a source is empty", hint="name a folder or a URL: --source https://host/releases")
        protocol = self.url.partition("://")[0] if "://" in self.url else "file"
        self.local = protocol in ("file", "local") and "::" not in self.url
        if self.local and "://" not in self.url:
            self.url = str(absolute(self.url))
        self.label = label(self.url)
        self._secret = has_secret(self.url)
        try:
            self._web = _web_folder(protocol, self.url)
        except ValueError as error:
            raise self._unusable(str(error) if protocol == "hf" else "it is not a URL") from error
        self._lock = threading.Lock()
        self._opened: tuple[Any, str] | None = None

    def __repr__(self) -> str:
        return f"Source({self.label!r})"

    def check(self) -> None:
        """Raise InputError where the URL cannot be one, or a package that reads it is missing."""
        try:
            if self._web is None:
                self._filesystem()
            else:
                self._web.check()
        except ImportError as error:
            hint = str(error)
            if self.url.rpartition("::")[2].startswith("hf://"):
                hint = install("rema[hf]")
            elif self.url.startswith(("s3://", "s3a://")):
                hint = install("rema[s3]")
            elif self.url.rpartition("::")[2].startswith(("http://", "https://")):
                hint = install("fsspec[http]")
            raise InputError(
                f"the source {self.label} needs a package that is not installed", hint=hint, source=self.label
            ) from error
        except ValueError as error:
            ours = self._web is not None or not self._secret
            raise self._unusable(str(error) if ours else type(error).__name__) from error
        except Exception:  # a server that does not answer now is found out when it is needed
            return

    def _unusable(self, why: str) -> InputError:
        hint = "name a folder, or a URL that begins with file://, https://, hf://, s3:// or another fsspec protocol"
        if self._secret:
            hint += "; in credentials, write / as %2F, @ as %40, ? as %3F, # as %23 and : as %3A"
        return InputError(f"the source {self.label} cannot be used: {why}", hint=hint, source=self.label)

    def folder(self) -> Path | None:
        """The folder of a local source."""
        return Path(self._filesystem()[1]) if self.local else None

    def places(self, location: str) -> tuple[str, ...]:
        """Where a file, ``holder/path``, may lie below the URL: a URL may be that of the release's own folder."""
        holder, _, path = location.partition("/")
        name = self._web.name if isinstance(self._web, HubFolder) else self.url.rstrip("/").rpartition("/")[2]
        own = name == holder
        return (location, path) if own else (location,)

    @contextmanager
    def open(self, location: str, start: int, size: int) -> Iterator[tuple[int, Callable[[int], bytes]]]:
        """A file of ``size`` bytes, ``holder/path``, from byte ``start`` on.

        Yields the offset of the first byte (``start``, or 0 where a server ignores ranges), and a function that reads:
        it takes the largest number of bytes and returns as many as have arrived, none at the end. Both raise
        ``Refused`` where the file is absent or another one comes in its place, and ``Faltered`` where the source does
        not answer now.
        """
        with ExitStack() as stack:
            *others, last = self.places(location)
            for place in others:
                try:
                    first, read = stack.enter_context(self._open(place, start, size))
                    break
                except Refused as error:
                    if not error.absent:
                        raise
            else:
                first, read = stack.enter_context(self._open(last, start, size))

            def next_bytes(most: int) -> bytes:
                try:
                    return read(most)
                except Exception as error:
                    raise self._failure(error) from error

            yield first, next_bytes

    @contextmanager
    def _open(self, location: str, start: int, size: int) -> Iterator[tuple[int, Callable[[int], bytes]]]:
        opened = self._open_blocks if self._web is None else self._web.open
        with ExitStack() as stack:
            try:
                found = stack.enter_context(opened(location, start, size))
            except (Refused, Faltered):
                raise
            except _TIMEOUTS as error:
                raise Refused(f"does not answer{self._advice}") from error
            except Exception as error:
                raise self._failure(error) from error
            yield found

    def close(self) -> None:
        """Close the connections that are kept for the next file."""
        if self._web is not None:
            self._web.close()

    def _filesystem(self) -> tuple[Any, str]:
        """The fsspec file system and the path of the source in it."""
        from fsspec.core import url_to_fs

        with self._lock:
            if self._opened is None:
                filesystem, path = url_to_fs(self.url)
                self._opened = filesystem, str(path)
            return self._opened

    @contextmanager
    def _open_blocks(self, location: str, start: int, size: int) -> Iterator[tuple[int, Callable[[int], bytes]]]:
        filesystem, base = self._filesystem()
        path = f"{base.rstrip('/')}/{location}" if base else location
        got = filesystem.size(path)
        if got is not None and got != size:
            raise Refused(f"has {got:,} bytes there, expected {size:,}")
        with filesystem.open(path, "rb", block_size=_BLOCK, cache_type="none") as file:
            if start:
                file.seek(start)
            yield start, lambda most: file.read(min(most, _CHUNK if self.local else _BLOCK))

    def _failure(self, error: Exception) -> Refused | Faltered:
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
            return answered(status, getattr(error, "message", ""))
        if isinstance(error, _TIMEOUTS):
            return Faltered("sends nothing more")
        return Faltered(f"{self._words(error)}{self._advice}")

    @property
    def _advice(self) -> str:
        return self._web.advice if isinstance(self._web, HubFolder) else ""

    def _words(self, error: Exception) -> str:
        """The cause of an error in a line."""
        if isinstance(error, HTTPError):
            causes = (error.__cause__, *error.args)
            cause = next((cause for cause in causes if isinstance(cause, Exception)), None)
            if cause is not None:
                return self._words(cause)
        name = type(error).__name__
        if self._secret:  # what a library says may hold the URL, or a part of it
            return getattr(error, "strerror", None) or name
        lines = str(error).replace(self.url, self.label).splitlines()
        if not lines:
            return name
        return (lines[0] if isinstance(error, OSError) else f"{name}: {lines[0]}")[:_LONGEST_ANSWER]
