"""What lies between a source and its web server: logins, redirects, proxies, packed answers, kept connections."""

from __future__ import annotations

import gzip
import sys
import threading
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from rema_data.download import download
from rema_data.errors import InputError, MissingFileError
from tests.rema_data.download.conftest import BLOCK, Mirrored, Publish, fetched
from tests.rema_data.download.servers import serve

Answer = tuple[int, dict[str, str], bytes]


@dataclass
class Web:
    """A server that answers as a function of path and headers, and notes both."""

    url: str = ""
    asked: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    connections: int = 0

    def sent(self, header: str) -> set[str | None]:
        """What came in a header, over all requests."""
        return {headers.get(header) for _, headers in self.asked}


@contextmanager
def web(answer: Callable[[str, dict[str, str]], Answer], hang_up: bool = False) -> Iterator[Web]:
    """A server on this machine; it may hang up after every answer without saying so."""
    made = Web()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def setup(self) -> None:
            made.connections += 1
            super().setup()

        def do_GET(self) -> None:
            made.asked.append((self.path, dict(self.headers)))
            status, headers, body = answer(self.path, dict(self.headers))
            self.send_response(status)
            for name, value in {"Content-Length": str(len(body)), **headers}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)
            self.close_connection = self.close_connection or hang_up

        def log_message(self, format: str, *args: Any) -> None:
            """Keep the test's output clean."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    made.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield made
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def basic(words: str) -> str:
    return f"Basic {b64encode(words.encode()).decode()}"


@pytest.fixture
def tiny(publish: Publish) -> Iterator[Mirrored]:
    """A release of which every download is whole in the end."""
    made = publish(sizes={f"{BLOCK}/maps.zarr/{number}": 1000 for number in range(6)})
    yield made
    assert fetched() == made.content()


def files(made: Mirrored, prefix: str = "") -> Callable[[str, dict[str, str]], Answer]:
    content = made.content()
    return lambda path, headers: (200, {}, content[path.removeprefix(prefix).lstrip("/")])


@pytest.mark.parametrize("hang_up", [False, True])
def test_a_connection_is_kept_while_the_server_keeps_it(tiny: Mirrored, hang_up: bool) -> None:
    with web(files(tiny), hang_up) as server:
        download("tiny", sources=[server.url], jobs=1)
        assert len(server.asked) == 6 and server.connections == (6 if hang_up else 1)


def test_the_password_of_the_url(tiny: Mirrored) -> None:
    with web(files(tiny)) as server:
        download("tiny", sources=[server.url.replace("//", "//me:p%40ss@")])
        assert server.sent("Authorization") == {basic("me:p@ss")}


def test_netrc(tiny: Mirrored, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "netrc").write_text("machine 127.0.0.1 login me password secret\n")
    monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))
    with web(files(tiny)) as server:
        download("tiny", sources=[server.url])
        assert server.sent("Authorization") == {basic("me:secret")}


@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
def test_redirects_are_followed_without_the_password(tiny: Mirrored, status: int) -> None:
    part = Path("home/releases/tiny") / BLOCK / "maps.zarr" / "0.part"
    part.parent.mkdir(parents=True)
    part.write_bytes(tiny.content()[f"tiny/{BLOCK}/maps.zarr/0"][:400])
    with serve(tiny.folder) as store:
        with web(lambda path, headers: (status, {"Location": store.url + path}, b"there")) as door:
            report = download("tiny", sources=[door.url.replace("//", "//me:pass@")], jobs=1)
            assert door.sent("Authorization") == {basic("me:pass")} and door.connections == 1
        assert report.moved_bytes == tiny.size() - 400
        assert sorted(start for _, start in store.requests) == [0, 0, 0, 0, 0, 400]


def test_a_redirect_within_the_server_keeps_the_password(tiny: Mirrored) -> None:
    plain = files(tiny, "/new")

    def answer(path: str, headers: dict[str, str]) -> Answer:
        return plain(path, headers) if path.startswith("/new") else (302, {"Location": f"/new{path}"}, b"")

    with web(answer) as server:
        download("tiny", sources=[server.url.replace("//", "//me:pass@")])
        assert server.sent("Authorization") == {basic("me:pass")}


@pytest.mark.parametrize(
    ("target", "words"), [("/again", "redirects more than 10 times"), ("file:///etc/passwd", "not on the web")]
)
def test_redirects_that_lead_nowhere(tiny: Mirrored, target: str, words: str) -> None:
    def answer(path: str, headers: dict[str, str]) -> Answer:
        return 302, {"Location": target}, b""

    with web(answer) as server, pytest.raises(MissingFileError, match=words):
        download("tiny", sources=[server.url])
    download("tiny", sources=[tiny.folder])


def test_the_proxy_of_the_environment(tiny: Mirrored, monkeypatch: pytest.MonkeyPatch) -> None:
    with web(files(tiny, "http://far.invalid/data")) as proxy:
        monkeypatch.setenv("http_proxy", proxy.url.replace("//", "//me:pass@"))
        download("tiny", sources=["http://far.invalid/data"])
        assert proxy.sent("Proxy-Authorization") == {basic("me:pass")} and proxy.sent("Host") == {"far.invalid"}


def test_a_packed_answer_is_unpacked(tiny: Mirrored) -> None:
    plain = files(tiny)

    def packed(path: str, headers: dict[str, str]) -> Answer:
        return 200, {"Content-Encoding": "gzip"}, gzip.compress(plain(path, headers)[2])

    with web(packed) as server:
        download("tiny", sources=[server.url])


def test_an_answer_in_pieces(tiny: Mirrored) -> None:
    plain = files(tiny)

    def pieces(path: str, headers: dict[str, str]) -> Answer:
        body = plain(path, headers)[2]
        made = b"".join(b"%x\r\n%b\r\n" % (len(piece), piece) for piece in (body[:300], body[300:], b""))
        return 200, {"Transfer-Encoding": "chunked"}, made

    with web(pieces) as server:
        download("tiny", sources=[server.url])


@pytest.mark.parametrize("url", ["http:///releases", "http://me:pass@:80/x", "http://me:pass@host:word/x"])
def test_urls_without_a_server(publish: Publish, url: str) -> None:
    publish()
    with pytest.raises(InputError, match=r"names no host|not a number") as caught:
        download("tiny", sources=[url])
    assert "pass" not in str(caught.value)


def test_a_chain_over_the_web_without_its_package(publish: Publish, monkeypatch: pytest.MonkeyPatch) -> None:
    from importlib import import_module

    publish()
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    monkeypatch.delitem(sys.modules, "fsspec.implementations.http", raising=False)
    for name in ("http", "https"):
        monkeypatch.delitem(import_module("fsspec.registry")._registry, name, raising=False)
    with pytest.raises(InputError, match="needs a package") as caught:
        download("tiny", sources=["zip://::https://host/all.zip"])
    assert caught.value.hint == 'pip install "fsspec[http]"'


@pytest.mark.parametrize("scheme", ["http", "https"])
def test_a_dead_proxy_is_named_and_the_mirror_is_not_blamed(
    publish: Publish, monkeypatch: pytest.MonkeyPatch, scheme: str
) -> None:
    publish()
    monkeypatch.setenv(f"{scheme}_proxy", "http://me:secret@127.0.0.1:9")
    with pytest.raises(MissingFileError) as caught:
        download("tiny", sources=[f"{scheme}://far.invalid/data"])
    said = str(caught.value)
    assert f"the proxy http://127.0.0.1:9 ({scheme}_proxy) cannot be used: Connection refused" in said
    assert f"correct or unset {scheme}_proxy" in said and "secret" not in said


def test_a_proxy_that_lets_nobody_through(publish: Publish, monkeypatch: pytest.MonkeyPatch) -> None:
    publish()
    with web(lambda path, headers: (407, {}, b"")) as proxy:
        monkeypatch.setenv("https_proxy", proxy.url)
        with pytest.raises(MissingFileError, match=r"the proxy http://127.0.0.1:\d+ \(https_proxy\) cannot be used"):
            download("tiny", sources=["https://far.invalid/data"])


def test_a_source_one_folder_too_deep(publish: Publish) -> None:
    tiny = publish()
    with serve(tiny.folder) as server:
        assert download("tiny", sources=[f"{server.url}/tiny/"]).sources == {f"{server.url}/tiny/": 3}
    assert fetched() == tiny.content()
