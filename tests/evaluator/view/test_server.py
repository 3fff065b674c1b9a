"""The server: the rows of the tables, pieces of them, refusals with their fix, and nobody else's requests."""

from __future__ import annotations

import http.client
import socket
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from evaluator.view import Viewer, open_source, serving
from rema_data.errors import InputError
from tests.evaluator.view.conftest import Client


@pytest.mark.parametrize("query", [{}, {"task": "grasp_push", "sort": "-sim_steps"}, {"q": "missed sim_steps>100"}])
def test_all_pieces_together_are_the_rows_of_the_table(query: dict[str, str], client: Client, viewer: Viewer) -> None:
    whole = viewer.rows("&".join(f"{name}={value}" for name, value in query.items()), limit=1000)["rows"]
    assert 0 < len(whole) <= 72
    found = []
    for offset in range(0, 72, 10):
        status, answer = client.get("api/rows", **query, offset=offset, limit=10)
        assert status == 200 and answer["total"] == len(whole)
        found += answer["rows"]
    assert found == whole


def test_a_piece_around_an_episode_has_it(client: Client, viewer: Viewer) -> None:
    name = viewer.rows("task=grasp_push")["rows"][13]["id"]
    _, answer = client.get("api/rows", task="grasp_push", limit=5, around=name)
    assert answer["position"] == 13 and answer["offset"] == 10
    assert answer["rows"][13 - answer["offset"]]["id"] == name
    _, answer = client.get("api/rows", task="grasp", limit=5, around=name)
    assert answer["position"] is None and answer["offset"] == 0


def test_a_link_with_an_episode_selects_as_without_it(client: Client) -> None:
    with_it = client.get("api/rows", task="grasp", episode="round-1/grasp/train/0", step=0)
    assert with_it == client.get("api/rows", task="grasp")


def test_episodes_and_pictures_are_those_of_the_viewer(client: Client, viewer: Viewer) -> None:
    name = viewer.source.table.ids[30]
    assert client.get("api/episode", episode=name) == (200, viewer.episode(name))
    for what in ("scene", "ee1", "ee2"):
        status, png = client.get("api/picture", episode=name, step=0, what=what)
        assert status == 200 and png == viewer.picture(name, 0, what)
    assert client.get("api/about") == (200, viewer.about())


@pytest.mark.parametrize(
    ("path", "query", "status", "sentence"),
    [
        ("api/episode", {"episode": "nobody"}, 400, "there is no episode 'nobody' in tiny"),
        ("api/rows", {"task": "fly"}, 400, "no episode has task fly"),
        ("api/rows", {"colour": "red"}, 400, "there is no column colour"),
        ("api/rows", {"offset": "-1"}, 400, "offset is '-1'"),
        ("api/rows", {"limit": "9" * 30}, 400, "limit is"),
        ("api/picture", {"episode": "round-1/grasp/train/0", "step": "x", "what": "scene"}, 400, "step is 'x'"),
        ("api/picture", {"episode": "round-1/grasp/train/0", "what": "../manifest.json"}, 400, "no picture"),
        ("api/picture", {"episode": "../../../../etc/passwd", "what": "scene"}, 400, "no episode"),
        ("manifest.json", {}, 404, "there is nothing at /manifest.json"),
        ("../../etc/passwd", {}, 404, "there is nothing at"),
        ("%2e%2e/manifest.json", {}, 404, "there is nothing at"),
    ],
)
def test_what_there_is_not_is_named_with_a_fix(
    path: str, query: dict[str, str], status: int, sentence: str, client: Client
) -> None:
    found, answer = client.get(path, **query)
    assert found == status
    assert sentence in answer["error"] and answer["hint"]


def ask(address: str, host: str, method: str = "GET") -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", urlsplit(address).port or 0, timeout=30)
    connection.request(method, "/api/about", headers={"Host": host})
    answer = connection.getresponse()
    found = answer.status, answer.read()
    connection.close()
    return found


def test_a_page_of_another_site_gets_nothing(client: Client) -> None:
    assert ask(client.address, "evil.example")[0] == 403
    assert ask(client.address, f"localhost:{urlsplit(client.address).port}")[0] == 200


def test_nothing_can_be_changed(client: Client) -> None:
    host = urlsplit(client.address).netloc
    assert ask(client.address, host, "POST")[0] == 501
    assert ask(client.address, host, "HEAD") == (200, b"")


def test_only_this_machine_is_answered(client: Client) -> None:
    assert client.address.startswith("http://127.0.0.1:")


def test_a_port_that_is_taken_is_named(viewer: Viewer) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=f"port {port} of 127.0.0.1 is taken") as caught, serving(viewer, port):
            pass
    assert "--port" in caught.value.hint


def test_the_port_is_free_again_at_the_end(viewer: Viewer) -> None:
    with serving(viewer) as address:
        port = urlsplit(address).port
        assert Client(address).get("api/rows")[0] == 200
    assert port is not None
    with serving(viewer, port) as again:
        assert Client(again).get("api/rows")[0] == 200


def test_damage_is_answered_and_told_once(copied: Path) -> None:
    (path,) = (path for path in (copied / "round-1/grasp/train/maps.zarr/scene/c").rglob("*") if path.is_file())
    path.write_bytes(bytes(path.stat().st_size))
    told: list[str] = []
    with serving(Viewer(open_source(str(copied))), note=told.append) as address:
        for _ in range(2):
            status, answer = Client(address).get("api/picture", episode="round-1/grasp/train/0", step=0, what="scene")
            assert status == 500 and "is damaged" in answer["error"] and "rema verify" in answer["hint"]
    (said,) = told
    assert str(copied) in said and "rema verify" in said


def test_a_bug_is_answered_and_the_server_goes_on(viewer: Viewer, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(name: str) -> None:
        raise KeyError("oh")

    told: list[str] = []
    with serving(viewer, note=told.append) as address, monkeypatch.context() as patch:
        patch.setattr(viewer, "episode", broken)
        status, answer = Client(address).get("api/episode", episode="x")
        assert status == 500 and "a bug in rema" in answer["error"]
        assert Client(address).get("api/rows")[0] == 200
    assert len(told) == 1
