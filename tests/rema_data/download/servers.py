"""A real HTTP server with ranges, that counts what it sends and fails as it is told."""

from __future__ import annotations

import mmap
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

CHUNK = 1 << 14


@dataclass(frozen=True)
class Fault:
    """What happens to one request.

    Attributes
    ----------
    kind : str
        ``drop`` closes the connection after ``n`` bytes, ``truncate`` declares and sends ``n`` bytes only, ``no_range``
        sends the whole file whatever was asked, ``other_range`` another range, ``status`` answers ``n`` (with
        ``Retry-After`` 0), ``html`` a web page, ``html_unsized`` one without a length, ``wrong`` flips every bit,
        ``wrong_drop`` does so and drops, ``long`` sends ``n`` bytes too many without a length, ``stall`` sends ``n``
        bytes and then nothing.
    n : int
    """

    kind: str
    n: int = 0


Faults = Callable[[str, int], Fault | None]
"""The fault of a request, by its path and by how many requests for that path came before."""


@dataclass
class FaultyServer:
    """Serves ``folder``; made by ``serve``.

    Attributes
    ----------
    sent : int
        Bytes of answers, headers aside.
    requests : list of (str, int)
        Path and first byte of every request.
    """

    folder: Path
    faults: Faults = lambda path, count: None
    bytes_per_second: float | None = None
    url: str = ""
    sent: int = 0
    requests: list[tuple[str, int]] = field(default_factory=list)
    ended: threading.Event = field(default_factory=threading.Event)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def arrived(self, path: str, start: int) -> Fault | None:
        """Note a request; its fault."""
        with self._lock:
            before = sum(1 for name, _ in self.requests if name == path)
            self.requests.append((path, start))
        return self.faults(path, before)

    def count(self, size: int) -> None:
        """Note bytes that were sent, at the rate of the server."""
        with self._lock:
            self.sent += size
            if self.bytes_per_second is not None:
                time.sleep(size / self.bytes_per_second)

    def wait_until_sent(self, size: int, timeout_s: float = 30.0) -> None:
        """Return when so many bytes have been sent in all."""
        deadline = time.monotonic() + timeout_s
        while self.sent < size:
            assert time.monotonic() < deadline, f"only {self.sent} of {size} bytes were sent"
            time.sleep(0.001)


def _view(file: Path) -> memoryview:
    """Content of a file, that is not read before it is sent."""
    if not file.stat().st_size:
        return memoryview(b"")
    with file.open("rb") as opened:
        return memoryview(mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ))


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: _Server

    def setup(self) -> None:
        self.request.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 * CHUNK)  # what counts as sent has left
        self.request.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        super().setup()

    def do_GET(self) -> None:
        server = self.server.owner
        path = unquote(urlsplit(self.path).path).lstrip("/")
        asked = self.headers.get("Range")
        start = int(asked.removeprefix("bytes=").partition("-")[0]) if asked else 0
        fault = server.arrived(path, start) or Fault("none")
        file = server.folder / path
        if fault.kind == "status":
            return self._answer(fault.n, b"no", {"Retry-After": "0"})
        if not file.is_file():
            return self._answer(404, b"no such file", {})
        whole = _view(file)
        if fault.kind == "html":
            return self._answer(200, b"<html>Log in first</html>", {"Content-Type": "text/html; charset=utf-8"})
        if fault.kind == "html_unsized":
            return self._answer(200, b"<html>" + bytes(whole), {"Content-Type": "text/html"}, length=None)
        if fault.kind == "long":
            return self._answer(200, bytes(whole) + b"x" * fault.n, {}, length=None)
        if fault.kind == "truncate":
            return self._answer(200, whole[: fault.n], {})
        if fault.kind.startswith("wrong"):
            whole = memoryview(bytes(byte ^ 255 for byte in whole))
        if fault.kind == "no_range":
            start, asked = 0, None
        if start >= len(whole) and asked:
            return self._answer(416, b"", {"Content-Range": f"bytes */{len(whole)}"})
        body = whole[start:]
        headers = {}
        if asked:
            shown = start + 1 if fault.kind == "other_range" else start
            headers["Content-Range"] = f"bytes {shown}-{len(whole) - 1}/{len(whole)}"
        limit = fault.n if fault.kind in ("drop", "wrong_drop", "stall") else len(body)
        self._answer(206 if asked else 200, body[:limit], headers, length=len(body))
        if fault.kind == "stall":
            server.ended.wait(60)
        if limit < len(body):
            self.close_connection = True
        return None

    def _answer(self, status: int, body: bytes | memoryview, headers: dict[str, str], length: int | None = -1) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        if length is None:
            self.send_header("Connection", "close")
            self.close_connection = True
        else:
            self.send_header("Content-Length", str(len(body) if length < 0 else length))
        self.end_headers()
        for start in range(0, len(body), CHUNK):
            part = body[start : start + CHUNK]
            self.wfile.write(part)
            self.server.owner.count(len(part))

    def log_message(self, format: str, *args: Any) -> None:
        """Keep the test's output clean."""


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    owner: FaultyServer

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that was killed is no error."""


@contextmanager
def serve(
    folder: Path, faults: Faults = lambda path, count: None, bytes_per_second: float | None = None
) -> Iterator[FaultyServer]:
    """A server of ``folder`` on this machine."""
    owner = FaultyServer(folder, faults, bytes_per_second)
    server = _Server(("127.0.0.1", 0), _Handler)
    server.owner = owner
    owner.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield owner
    finally:
        owner.ended.set()
        server.shutdown()
        server.server_close()
        thread.join()
