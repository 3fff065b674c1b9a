"""The page and its answers over HTTP, for this machine alone: bound to 127.0.0.1, read-only, no path of a request is
ever one of a file.
"""

from __future__ import annotations

import errno
import json
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qsl, urlencode, urlsplit

from evaluator.view.page import served_page
from evaluator.view.viewer import Viewer
from rema_data.errors import InputError, RemaError

__all__ = ["HOST", "serving"]

HOST = "127.0.0.1"
_IDLE_S = 30
"""A connection that asks for nothing is closed after so long."""
_OWN = ("offset", "limit", "around")
"""Parameters of ``rows`` besides those of the query."""
_KEPT_S = 600
"""A map may be kept by the browser so long: its address has the identity of what it shows."""


@contextmanager
def serving(viewer: Viewer, port: int = 0, note: Callable[[str], None] = lambda _: None) -> Iterator[str]:
    """Answer requests inside the block, in threads; gives the address of the page.

    Parameters
    ----------
    viewer : Viewer
    port : int
        By default a free one.
    note : callable
        Gets every error that is answered, once.

    Raises
    ------
    InputError
        The port is taken, or this user may not have it.
    """
    server = _open(viewer, port, note)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, name="rema view", daemon=True)
    thread.start()
    try:
        yield f"http://{HOST}:{server.server_port}/"
    finally:
        server.shutdown()
        server.server_close()


def _open(viewer: Viewer, port: int, note: Callable[[str], None]) -> _Server:
    try:
        return _Server((HOST, port), viewer, note)
    except OSError as error:
        if error.errno not in (errno.EADDRINUSE, errno.EACCES):
            raise
        why = "is taken" if error.errno == errno.EADDRINUSE else "may not be used by this user"
        raise InputError(
            f"port {port} of {HOST} {why}", hint="choose another --port, or leave it out for a free one", port=port
        ) from error


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False  # a film that is being drawn does not keep the command from ending
    allow_reuse_address = os.name == "posix"  # elsewhere it would take the port of another server

    def __init__(self, address: tuple[str, int], viewer: Viewer, note: Callable[[str], None]) -> None:
        super().__init__(address, _Handler)
        self.viewer = viewer
        self.page = served_page(viewer)
        self._note, self._noted = note, set[str]()
        self._lock = threading.Lock()

    def tell(self, text: str) -> None:
        """Note a fault once."""
        with self._lock:
            new = text not in self._noted
            self._noted.add(text)
        if new:
            self._note(text)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that has left is no error."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "rema", ""
    timeout = _IDLE_S

    def do_GET(self) -> None:
        port = self.server.server_port
        # A page of another site that resolves its name to this machine must not read from it.
        if self.headers.get("Host") not in (f"{HOST}:{port}", f"localhost:{port}"):
            self._json(HTTPStatus.FORBIDDEN, _fault(f"this server answers {HOST}:{port} only", "open that address"))
            return
        try:
            self._answer()
        except InputError as error:
            self._refuse(HTTPStatus.BAD_REQUEST, error)
        except RemaError as error:
            self._refuse(HTTPStatus.INTERNAL_SERVER_ERROR, error)
        except OSError:
            raise  # of the connection
        except Exception as error:  # whatever it is, the page says it, and the next request is answered
            text = f"a bug in rema: {type(error).__name__}: {error}"
            self.server.tell(text)
            self._json(HTTPStatus.INTERNAL_SERVER_ERROR, _fault(text, "report it, with the address of this page"))

    def do_HEAD(self) -> None:
        self.do_GET()

    def _refuse(self, status: HTTPStatus, error: RemaError) -> None:
        self.server.tell(str(error))
        self._json(status, _fault(error.message, error.hint))

    def _answer(self) -> None:
        viewer, address = self.server.viewer, urlsplit(self.path)
        asked = dict(parse_qsl(address.query, keep_blank_values=True))
        name, step = asked.get("episode", ""), _number(asked, "step", 0)
        match address.path:
            case "/":
                self._send(HTTPStatus.OK, "text/html; charset=utf-8", self.server.page)
            case "/api/about":
                self._json(HTTPStatus.OK, viewer.about())
            case "/api/rows":
                pairs = parse_qsl(address.query, keep_blank_values=True)
                query = urlencode([(key, value) for key, value in pairs if key not in _OWN])
                offset, limit = _number(asked, "offset", 0), _number(asked, "limit", 100)
                self._json(HTTPStatus.OK, viewer.rows(query, offset, limit, asked.get("around")))
            case "/api/episode":
                self._json(HTTPStatus.OK, viewer.episode(name))
            case "/api/picture":
                png = viewer.picture(name, step, asked.get("what", ""))
                self._send(HTTPStatus.OK, "image/png", png, f"private, max-age={_KEPT_S}")
            case "/api/stills":
                self._json(HTTPStatus.OK, viewer.stills(name, step))
            case "/api/film":
                self._json(HTTPStatus.OK, viewer.film(name, step))
            case other:
                self._json(HTTPStatus.NOT_FOUND, _fault(f"there is nothing at {other}", "open the address /"))

    def _json(self, status: HTTPStatus, content: Any) -> None:
        self._send(status, "application/json", json.dumps(content, allow_nan=False).encode())

    def _send(self, status: HTTPStatus, kind: str, body: bytes, kept: str = "no-store") -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", kept)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.send_header("Content-Security-Policy", "frame-ancestors 'self'")
        self.send_header("Referrer-Policy", "no-referrer")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, format: str, *arguments: Any) -> None:
        """Say nothing: the command prints faults, and no list of requests."""


def _fault(message: str, hint: str) -> dict[str, str]:
    return {"error": message, "hint": hint}


def _number(asked: dict[str, str], name: str, default: int) -> int:
    text = asked.get(name, str(default))
    if not (text.isascii() and text.isdecimal() and len(text) < 10):
        raise InputError(f"{name} is {text!r}", hint="give a whole number from 0 on")
    return int(text)
