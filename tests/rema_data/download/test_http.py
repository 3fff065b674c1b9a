"""Downloads from a real HTTP server, good and bad: every byte right, none needlessly twice, or a clear error."""

from __future__ import annotations

import socket
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rema_data.download import download
from rema_data.errors import IntegrityError, MissingFileError
from rema_data.progress import Silent
from rema_data.release.folder import downloads_folder
from tests.rema_data.download.conftest import BLOCK, Mirrored, Publish, fetched
from tests.rema_data.download.servers import CHUNK, Fault, Faults, serve

STEPS = f"tiny/{BLOCK}/steps.parquet"
SIZE = 200_000


def once(*faults: Fault) -> Faults:
    """The first requests for the steps fail like this, one after the other."""
    return lambda path, count: faults[count] if path == STEPS and count < len(faults) else None


def always(fault: Fault) -> Faults:
    return lambda path, count: fault if path == STEPS else None


def part() -> Path:
    path = downloads_folder() / f"{STEPS}.part"
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


@pytest.fixture
def tiny(publish: Publish) -> Iterator[Mirrored]:
    """A release of which every whole download ends in exact bytes."""
    made = publish()
    yield made
    assert fetched() == made.content()


def test_every_byte_once(tiny: Mirrored) -> None:
    with serve(tiny.folder) as server:
        report = download("tiny", sources=[server.url])
        assert (report.fetched_files, report.fetched_bytes, report.moved_bytes) == (3, tiny.size(), tiny.size())
        assert server.sent == tiny.size() and report.sources == {server.url: 3}
        again = download("tiny", sources=[server.url])
    assert (again.present_files, again.fetched_files, again.moved_bytes) == (3, 0, 0) and len(server.requests) == 3
    assert (downloads_folder() / "tiny" / "manifest.json").read_bytes() == tiny.manifest.to_bytes()
    assert not (downloads_folder() / STEPS).stat().st_mode & 0o222


@pytest.mark.parametrize(
    "faults",
    [
        [Fault("drop", 0)],
        [Fault("drop", 100_000)],
        [Fault("drop", 100_000), Fault("drop", 0), Fault("drop", 1)],
        [Fault("status", 503), Fault("status", 500)],
        [Fault("status", 429)],
        [Fault("long", 5)],
    ],
)
def test_passing_faults_do_no_harm(tiny: Mirrored, faults: list[Fault]) -> None:
    with serve(tiny.folder, once(*faults)) as server:
        report = download("tiny", sources=[server.url])
    assert report.moved_bytes == tiny.size()


def test_a_server_that_ignores_ranges_is_good_enough(tiny: Mirrored) -> None:
    part().write_bytes((tiny.folder / STEPS).read_bytes()[:50_000])
    with serve(tiny.folder, always(Fault("no_range"))) as server:
        report = download("tiny", sources=[server.url])
    assert report.moved_bytes == tiny.size()  # what is here already is passed over
    assert [start for path, start in server.requests if path == STEPS] == [50_000]


def test_a_connection_that_always_drops_still_gets_there(publish: Publish) -> None:
    big = publish(sizes={f"{BLOCK}/steps.parquet": 20_000_000})
    with serve(big.folder, always(Fault("drop", 2_000_000))) as server:
        assert download("tiny", sources=[server.url]).moved_bytes == big.size()
    assert fetched() == big.content()
    starts = [start for path, start in server.requests]
    assert starts == sorted(set(starts)) and len(starts) > 9
    assert server.sent - big.size() < len(starts) * 1_000_000  # what a dropped connection had buffered comes again


FINAL = {
    "absent": (Fault("status", 404), "does not have it"),
    "forbidden": (Fault("status", 403), "answered 403"),
    "web page": (Fault("html"), "sent 25 bytes of text/html, expected 200,000"),
    "web page without a length": (Fault("html_unsized"), "sent a web page"),
    "truncated": (Fault("truncate", 7), "sent 7 bytes, expected 200,000"),
    "other bytes": (Fault("wrong"), "sent other bytes than the release has"),
    "overloaded": (Fault("status", 503), "answered 503"),
    "silent": (Fault("drop", 0), "payload|Payload|stopped"),
}


@pytest.mark.parametrize("case", FINAL)
def test_the_next_mirror_delivers(tiny: Mirrored, case: str) -> None:
    fault, _ = FINAL[case]
    with serve(tiny.folder, always(fault)) as bad, serve(tiny.folder) as good:
        report = download("tiny", sources=[bad.url, good.url])
    assert report.sources == {bad.url: 2, good.url: 1}
    assert [path for path, _ in good.requests] == [STEPS]


@pytest.mark.parametrize("case", FINAL)
def test_no_mirror_delivers(tiny: Mirrored, case: str) -> None:
    fault, words = FINAL[case]
    with serve(tiny.folder, always(fault)) as server:
        with pytest.raises(MissingFileError if case != "other bytes" else IntegrityError, match=words) as caught:
            download("tiny", sources=[server.url])
        assert STEPS in caught.value.message and server.url in caught.value.message
        assert "rema download tiny --source URL" in caught.value.hint
        assert not (downloads_folder() / STEPS).exists()
        assert not (downloads_folder() / "tiny" / "manifest.json").exists()
        server.faults = lambda path, count: None
        assert download("tiny", sources=[server.url]).present_files == 2  # the others were fetched all the same


def test_another_range_than_the_one_asked_for(tiny: Mirrored) -> None:
    with serve(tiny.folder, once(Fault("drop", 9), Fault("other_range"))) as bad, serve(tiny.folder) as good:
        report = download("tiny", sources=[bad.url, good.url])
    assert report.moved_bytes == tiny.size() and report.sources == {bad.url: 2, good.url: 1}


def test_a_mirror_that_is_down(tiny: Mirrored) -> None:
    with socket.create_server(("127.0.0.1", 0)) as unused:
        down = f"http://127.0.0.1:{unused.getsockname()[1]}"
    with serve(tiny.folder) as good:
        assert download("tiny", sources=[down, good.url]).sources == {good.url: 3}


def test_a_mirror_that_keeps_failing_is_not_asked_again(publish: Publish) -> None:
    notes: list[str] = []

    class Notes(Silent):
        def note(self, text: str) -> None:
            notes.append(text)

    many = publish(sizes={f"{BLOCK}/maps.zarr/{number}": 100 for number in range(40)})
    with serve(many.folder, lambda path, count: Fault("status", 500)) as bad, serve(many.folder) as good:
        report = download("tiny", sources=[bad.url, good.url], jobs=2, progress=Notes())
    assert fetched() == many.content() and report.sources == {good.url: 40}
    assert len(bad.requests) <= 6 and [bad.url in note and "answered 500" in note for note in notes] == [True]


def test_everything_down_ends_soon(publish: Publish) -> None:
    many = publish(sizes={f"{BLOCK}/maps.zarr/{number}": 100 for number in range(40)})

    def failing(path: str, count: int) -> Fault:
        return Fault("status", 500)

    with serve(many.folder, failing) as bad, pytest.raises(MissingFileError, match="40 of 40 files") as caught:
        download("tiny", sources=[bad.url], jobs=2)
    assert len(bad.requests) <= 6 * 4 and len(caught.value.facts["files"]) == 40
    assert fetched() == {}


@pytest.mark.parametrize("have", [1, 100_000, SIZE - 1, SIZE])
def test_resumed_at_the_byte(tiny: Mirrored, have: int) -> None:
    part().write_bytes((tiny.folder / STEPS).read_bytes()[:have])
    with serve(tiny.folder) as server:
        assert download("tiny", sources=[server.url]).moved_bytes == tiny.size() - have
    assert [start for path, start in server.requests if path == STEPS] == ([have] if have < SIZE else [])


@pytest.mark.parametrize(("have", "moved"), [(100_000, 100_000 + SIZE), (SIZE, SIZE), (SIZE + 1, SIZE)])
def test_a_wrong_part_is_thrown_away_once(tiny: Mirrored, have: int, moved: int) -> None:
    part().write_bytes(b"x" * have)
    with serve(tiny.folder) as server:
        assert download("tiny", sources=[server.url]).moved_bytes == tiny.size() - SIZE + moved


def test_bytes_of_a_wrong_mirror_do_not_spoil_the_next(tiny: Mirrored) -> None:
    """A wrong beginning is completed by the next mirror, which is then asked for all of the file."""
    faults = [Fault("wrong_drop", SIZE // 2), *[Fault("status", 404)] * 9]
    with serve(tiny.folder, once(*faults)) as bad, serve(tiny.folder) as good:
        report = download("tiny", sources=[bad.url, good.url])
    assert report.sources == {bad.url: 2, good.url: 1}


def test_a_file_of_another_size_is_fetched_again(tiny: Mirrored) -> None:
    part().with_name("steps.parquet").write_bytes(b"short")
    with serve(tiny.folder) as server:
        assert download("tiny", sources=[server.url]).fetched_files == 3


def test_secrets_stay_out_of_messages(tiny: Mirrored) -> None:
    with serve(tiny.folder, always(Fault("status", 403))) as server:
        url = server.url.replace("http://", "http://me:pass@") + "?token=abc"
        with pytest.raises(MissingFileError, match=server.url) as caught:
            download("tiny", sources=[url])
        assert "pass" not in str(caught.value) and "abc" not in str(caught.value)
        server.faults = lambda path, count: None
        assert download("tiny", sources=[url]).sources == {server.url: 1}


def test_names_that_need_quoting(publish: Publish) -> None:
    odd = publish(sizes={f"{BLOCK}/maps.zarr/a b#c?d%20é+": 10})
    with serve(odd.folder) as server:
        download("tiny", sources=[server.url + "/"])
    assert fetched() == odd.content()


FAULTS = st.builds(
    Fault,
    st.sampled_from(["drop", "truncate", "no_range", "other_range", "html", "html_unsized", "wrong", "long"]),
    st.integers(0, 3 * CHUNK),
) | st.builds(Fault, st.just("status"), st.sampled_from([403, 404, 416, 429, 500, 503]))


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(first=st.lists(FAULTS, max_size=6), second=st.lists(FAULTS, max_size=6), have=st.integers(0, 3 * CHUNK))
def test_any_faults_end_in_exact_bytes_or_a_clear_error(
    publish: Publish, monkeypatch: pytest.MonkeyPatch, first: list[Fault], second: list[Fault], have: int
) -> None:
    made = publish(sizes={f"{BLOCK}/steps.parquet": 2 * CHUNK})
    with tempfile.TemporaryDirectory() as home:
        monkeypatch.setenv("REMA_HOME", home)
        part().write_bytes(b"x" * have if have % 2 else (made.folder / STEPS).read_bytes()[:have])
        with serve(made.folder, once(*first)) as one, serve(made.folder, once(*second)) as two:
            sources = [one.url, two.url]
            with suppress(MissingFileError, IntegrityError):
                download("tiny", sources=sources)
            done = (downloads_folder() / STEPS).exists()
            if done:
                assert fetched() == made.content()
            one.faults = two.faults = lambda path, count: None
            assert download("tiny", sources=sources).fetched_files == (0 if done else 1)
        assert fetched() == made.content()
