"""The Hugging Face Hub: a server that speaks its resolve API, its store for large files, and everything it refuses."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from huggingface_hub import constants

from rema_data.download import download
from rema_data.download.labels import has_secret, label
from rema_data.download.sources import Source
from rema_data.errors import InputError, MissingFileError
from rema_data.release.folder import downloads_folder
from tests.rema_data.download.conftest import BLOCK, Mirrored, Publish, fetched
from tests.rema_data.download.servers import FaultyServer, serve
from tests.rema_data.download.test_web import Answer, Web, web

TOKEN = "hf_" + "Zx9" * 11
SOURCE = "hf://datasets/lab/data"
LARGE = f"tiny/{BLOCK}/steps.parquet"


@pytest.fixture(autouse=True)
def nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine without a token."""
    for name in ("HF_TOKEN", "HUGGING_FACE_HUB_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(constants, "HF_TOKEN_PATH", str(tmp_path / "token"))
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)


@pytest.fixture
def tiny(publish: Publish) -> Mirrored:
    return publish()


@pytest.fixture
def store(tiny: Mirrored) -> Iterator[FaultyServer]:
    """Where the hub keeps large files: another server, with ranges."""
    with serve(tiny.folder) as server:
        yield server


@pytest.fixture
def hub(tiny: Mirrored, store: FaultyServer, monkeypatch: pytest.MonkeyPatch) -> Iterator[Web]:
    """A hub with one dataset, of which ``main`` and ``refs/pr/1`` hold the release."""
    yield from _hub(tiny, store, monkeypatch, lambda headers: None)


Refusal = Callable[[dict[str, str]], Answer | None]


def _hub(tiny: Mirrored, store: FaultyServer, patch: pytest.MonkeyPatch, refusal: Refusal) -> Iterator[Web]:
    small = tiny.content()

    def answer(path: str, headers: dict[str, str]) -> Answer:
        refused = refusal(headers)
        if refused is not None:
            return refused
        if path.startswith("/api/resolve-cache/"):  # small files: a redirect on the hub itself, relative
            return 200, {}, small[path.removeprefix("/api/resolve-cache/")]
        repository, _, rest = path.partition("/resolve/")
        if repository not in ("/datasets/lab/data", "/datasets/lab/tiny"):
            return 401, {"X-Error-Code": "RepoNotFound", "X-Error-Message": "Invalid username or password."}, b"no"
        revision, _, location = rest.partition("/")
        if revision not in ("main", "refs%2Fpr%2F1"):
            return 404, {"X-Error-Code": "RevisionNotFound", "X-Error-Message": f"Invalid rev id: {revision}"}, b"no"
        if repository.endswith("tiny"):
            location = f"tiny/{location}"
        if location not in small:
            return 404, {"X-Error-Code": "EntryNotFound"}, b"no"
        if location == LARGE:
            return 302, {"Location": f"{store.url}/{location}?signature=1", "X-Linked-Etag": '"1"'}, b""
        return 307, {"Location": f"/api/resolve-cache/{location}"}, b""

    with web(answer) as server:
        patch.setattr(constants, "ENDPOINT", server.url)
        yield server


def refusing(hub: Web, monkeypatch: pytest.MonkeyPatch, answer: Answer) -> Iterator[Web]:
    with web(lambda path, headers: answer) as server:
        monkeypatch.setattr(constants, "ENDPOINT", server.url)
        yield server


@pytest.mark.parametrize("source", [SOURCE, f"{SOURCE}@main/", f"{SOURCE}@refs/pr/1", f"{SOURCE}@refs%2Fpr%2F1"])
def test_a_release_comes_from_the_hub(tiny: Mirrored, hub: Web, store: FaultyServer, source: str) -> None:
    report = download("tiny", sources=[source])
    assert fetched() == tiny.content() and report.sources == {source: 3}
    assert [path for path, _ in store.requests] == [LARGE]


def test_a_data_set_that_is_the_release(tiny: Mirrored, hub: Web) -> None:
    assert download("tiny", sources=["hf://datasets/lab/tiny@main"]).sources == {"hf://datasets/lab/tiny@main": 3}
    assert fetched() == tiny.content()


def test_a_large_file_resumes_at_its_byte(tiny: Mirrored, hub: Web, store: FaultyServer) -> None:
    part = downloads_folder() / f"{LARGE}.part"
    part.parent.mkdir(parents=True)
    part.write_bytes(tiny.content()[LARGE][:150_000])
    report = download("tiny", sources=[SOURCE])
    assert fetched() == tiny.content() and store.requests == [(LARGE, 150_000)]
    assert report.moved_bytes == tiny.size() - 150_000


def test_the_token_goes_to_the_hub_alone(tiny: Mirrored, hub: Web, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    asked: list[dict[str, str]] = []

    def elsewhere(path: str, headers: dict[str, str]) -> Answer:
        asked.append(headers)
        return 200, {}, tiny.content()[LARGE]

    with web(elsewhere) as other:
        redirects = _hub(tiny, FaultyServer(tiny.folder, url=other.url), monkeypatch, lambda headers: None)
        server = next(redirects)
        download("tiny", sources=[SOURCE])
        assert server.sent("Authorization") == {f"Bearer {TOKEN}"}
        redirects.close()
    assert len(asked) == 1 and "Authorization" not in asked[0]


GATED = (403, {"X-Error-Code": "GatedRepo", "X-Error-Message": "Access is restricted"}, b"no")
MISSING = (401, {"X-Error-Code": "RepoNotFound"}, b"no")


@pytest.mark.parametrize(
    ("answer", "token", "says"),
    [
        (GATED, "", ["accept its conditions at http://127.0.0.1", "/datasets/lab/data", "hf auth login"]),
        ((401, *GATED[1:]), TOKEN, ["accept its conditions"]),
        (MISSING, "", ["is not there, or is private", "check its name", "hf auth login"]),
        (MISSING, TOKEN, ["is not there, or is private", "as somebody who may read it"]),
        ((401, {}, b""), "", ["is private", "HF_TOKEN"]),
        ((401, {}, b""), TOKEN, ["refuses the token of this machine", "hf auth login"]),
        ((403, {}, b""), TOKEN, ["a token that may read lab/data"]),
        ((404, {"X-Error-Code": "RevisionNotFound"}, b""), "", ["has no revision main", "branches, tags or commits"]),
        ((404, {"X-Error-Code": "EntryNotFound"}, b""), "", ["does not have it"]),
        ((429, {"Retry-After": "7"}, b""), "", ["try again in 7 s", "--jobs 2", "hf auth login", "(it resumes)"]),
        ((429, {"RateLimit": '"resolvers";r=0;t=90'}, b""), TOKEN, ["try again in 90 s with --jobs 2\n"]),
        ((429, {}, b""), "", ["try again in a few minutes"]),
        ((503, {}, b""), "", ["503", "https://status.huggingface.co", "HF_ENDPOINT", "(it resumes)"]),
    ],
)
def test_a_refusal_says_what_helps(
    tiny: Mirrored, hub: Web, monkeypatch: pytest.MonkeyPatch, answer: Answer, token: str, says: list[str]
) -> None:
    monkeypatch.setattr("rema_data.download.transfer.LONGEST_WAIT_S", 0.01)
    if token:
        monkeypatch.setenv("HF_TOKEN", token)
    for _ in refusing(hub, monkeypatch, answer):
        with pytest.raises(MissingFileError) as caught:
            download("tiny", sources=[SOURCE])
    text = str(caught.value)
    assert all(words in text for words in says), text
    assert f"  {SOURCE}: " in text and TOKEN[:8] not in text
    assert fetched() == {}


def test_a_limit_that_passes_is_waited_for(
    tiny: Mirrored, store: FaultyServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    limited = iter([(429, {"Retry-After": "0"}, b"")] * 3)
    for _ in _hub(tiny, store, monkeypatch, lambda headers: next(limited, None)):
        assert download("tiny", sources=[SOURCE], jobs=1).sources == {SOURCE: 3}
    assert fetched() == tiny.content()


def test_a_hub_that_is_down(tiny: Mirrored, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(constants, "ENDPOINT", "http://127.0.0.1:9")
    with pytest.raises(MissingFileError, match=r"says whether the hub is down, HF_ENDPOINT names a mirror") as caught:
        download("tiny", sources=[SOURCE])
    assert "does not answer; " in str(caught.value)


@pytest.mark.parametrize("token", [f"{TOKEN}\nX", f"{TOKEN}\u2026", f"{TOKEN} x"])
def test_a_token_that_cannot_be_sent_is_not_shown(
    tiny: Mirrored, hub: Web, monkeypatch: pytest.MonkeyPatch, token: str
) -> None:
    monkeypatch.setattr("huggingface_hub.get_token", lambda: token)
    with pytest.raises(MissingFileError, match="has characters that none has") as caught:
        download("tiny", sources=[SOURCE])
    assert TOKEN[:8] not in str(caught.value) and not hub.asked


def test_the_offline_switch_of_the_hub(tiny: Mirrored, hub: Web, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    with pytest.raises(MissingFileError, match="HF_HUB_OFFLINE is set: unset it"):
        download("tiny", sources=[SOURCE])
    assert not hub.asked


def test_without_the_package(tiny: Mirrored, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(InputError, match=r'pip install "rema\[hf\]"'):
        download("tiny", sources=[SOURCE])
    with pytest.raises(InputError, match=r'pip install "rema\[hf\]"'):
        download("tiny", sources=[f"simplecache::{SOURCE}"])


def test_an_endpoint_that_is_no_url(tiny: Mirrored, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(constants, "ENDPOINT", "localhost")
    with pytest.raises(InputError, match="HF_ENDPOINT is not the URL of a hub"):
        download("tiny", sources=[SOURCE])


@pytest.mark.parametrize(
    "url",
    ["hf://lab/data", "hf://datasets/data", "hf://models/lab/data", "hf://datasets/lab/data@a/b@c", f"{SOURCE}?x=1"],
)
def test_what_is_not_a_data_set(url: str) -> None:
    with pytest.raises(InputError, match="it is not hf://datasets/ORG/NAME"):
        Source(url)


def test_labels_show_the_revision_and_never_a_token() -> None:
    assert label(f"{SOURCE}@v1/folder") == f"{SOURCE}@v1/folder" and not has_secret(f"{SOURCE}@v1")
    for url in (f"hf://me:{TOKEN}@datasets/lab/data", f"{SOURCE}@{TOKEN}", f"{SOURCE}?token={TOKEN}"):
        assert TOKEN[:6] not in label(url) and has_secret(url), url
        with pytest.raises(InputError) as caught:
            Source(url)
        assert TOKEN[:6] not in str(caught.value)


def test_the_command_asks_the_endpoint_of_the_environment(tiny: Mirrored, hub: Web, tmp_path: Path) -> None:
    environment = {**os.environ, "HF_ENDPOINT": hub.url, "HF_TOKEN": TOKEN, "HF_HOME": str(tmp_path / "hf")}
    done = subprocess.run(
        [sys.executable, "-m", "evaluator.cli", "download", "tiny", "--source", SOURCE],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert f"from {SOURCE}" in done.stdout and TOKEN[:8] not in done.stdout + done.stderr
    assert fetched() == tiny.content() and hub.sent("Authorization") == {f"Bearer {TOKEN}"}
