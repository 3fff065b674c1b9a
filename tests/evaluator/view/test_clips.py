"""One episode as a film and as a recording for Rerun, where these packages are; what is said where they are not."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from evaluator.render.film import FilmMaker
from evaluator.sim.parameters import WORLD
from evaluator.view import Viewer, open_source, video
from evaluator.view.recording import write_recording
from evaluator.view.source import takes
from evaluator.view.video import write_video
from rema_data.errors import InputError
from rema_data.progress import Silent

WRITERS = {".mp4": write_video, ".rrd": write_recording}


@pytest.fixture(scope="module")
def pushes(push_run: Path) -> Viewer:
    return Viewer(open_source(str(push_run)))


def test_a_film_has_the_frames_of_the_simulation(
    pushes: Viewer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    av: Any = pytest.importorskip("av")
    monkeypatch.setattr(video, "SIZE", (160, 120))
    name = pushes.rows("outcome=success")["rows"][0]["id"]
    frames = write_video(pushes, name, tmp_path / "a.mp4")
    with av.open(str(tmp_path / "a.mp4")) as film:
        (stream,) = film.streams.video
        found = list(film.decode(stream))
    assert len(found) == frames and (found[0].width, found[0].height) == (160, 120)
    simulated_s = pushes.step(name, 0)[1].row["sim_steps"] * WORLD.time_step_s
    assert frames / stream.average_rate == pytest.approx(1.5 + simulated_s, abs=0.2)  # in real time, with its ends


def test_a_recording_can_be_read(pushes: Viewer, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    name = pushes.rows("outcome=success")["rows"][0]["id"]
    assert write_recording(pushes, name, tmp_path / "a.rrd") == 1
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", "-v", str(tmp_path / "a.rrd")], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    for entity in ("/scene", "/end_effector/state_2/mask", "/world/action", "/world/objects/target_0", "/step"):
        assert entity in done.stdout


class Notes(Silent):
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


def test_an_episode_that_ends_earlier_here_is_not_continued(
    viewer: Viewer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another simulator may fail a step after which others are recorded: no step is shown in place of another one."""
    pytest.importorskip("av")
    pytest.importorskip("rerun")
    monkeypatch.setattr(video, "SIZE", (160, 120))
    source, name = viewer.source, viewer.rows("task=grasp_push&outcome=success")["rows"][0]["id"]
    place = viewer.place(name)
    first, second = source.steps(place)
    with FilmMaker() as films:
        ended = source.take(place, first.number, films)
        monkeypatch.setattr(source, "take", lambda *_: ended)
        told = Notes()
        assert list(takes(source, place, [first, second], films, told)) == [(first, ended)]
        sentence = f"played again here, {name} ends at step 1: the later steps that are recorded are left out"
        assert told.notes == [sentence]
    told = Notes()
    assert write_recording(viewer, name, tmp_path / "a.rrd", told) == 1 and told.notes == [sentence]
    frames = write_video(viewer, name, tmp_path / "a.mp4", told)
    monkeypatch.setattr(source, "steps", lambda _: [first])
    assert frames == write_video(viewer, name, tmp_path / "b.mp4", told) and told.notes == [sentence] * 2


@pytest.mark.parametrize("suffix", WRITERS)
def test_what_cannot_be_written_is_refused(suffix: str, pushes: Viewer, tmp_path: Path) -> None:
    package = "av" if suffix == ".mp4" else "rerun"
    write: Callable[..., object] = WRITERS[suffix]
    with pytest.raises(InputError, match="is not a"):
        write(pushes, pushes.source.table.ids[0], tmp_path / "a.png")
    pytest.importorskip(package)
    silent = pushes.rows("failure=policy_error")["rows"][0]["id"]
    for name, sentence in ((silent, "no step of"), ("nobody", "there is no episode")):
        with pytest.raises(InputError, match=sentence):
            write(pushes, name, tmp_path / f"a{suffix}")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("package", "suffix", "extra"), [("av", ".mp4", "video"), ("rerun", ".rrd", "rerun")])
def test_without_the_extra_its_name_is_said(
    package: str, suffix: str, extra: str, pushes: Viewer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)  # as where it is not installed
    with pytest.raises(InputError, match="is not installed") as caught:
        WRITERS[suffix](pushes, pushes.source.table.ids[0], tmp_path / f"a{suffix}")
    assert f"rema[{extra}]" in caught.value.hint
