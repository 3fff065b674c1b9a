"""The film of one episode as an MP4 file: every step carried out again, in the time that it takes.

Needs PyAV and Pillow, which are the extra ``video``.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evaluator.sim.kinds import KINDS
from evaluator.sim.parameters import WORLD
from evaluator.view.source import takes
from evaluator.view.viewer import Viewer
from rema_data.errors import InputError
from rema_data.interrupts import check
from rema_data.pictures import GREEN, INK, RED, outcome_text, pillow, write_text
from rema_data.progress import Progress, Silent
from rema_data.repair import install
from rema_data.schema import to_dict
from rema_data.storage import write_atomic

if TYPE_CHECKING:
    from PIL import Image

    from evaluator.render.film import Take
    from evaluator.render.studio import Studio

__all__ = ["write_video"]

SIZE = (640, 480)
"""Width and height, pixels."""
_SHOTS = 2
"""Every second shot of a take is a frame."""
_BEFORE_S, _AFTER_S = 0.5, 1.0
"""How long the first and the last picture of a step stand still."""


def write_video(viewer: Viewer, name: str, path: Path, progress: Progress | None = None) -> int:
    """Write the film of an episode; gives its number of frames. It ends where the episode does, played again here.

    Raises
    ------
    InputError
        There is no such episode, no step of it can be played, the file is not to be an MP4 file, or PyAV or Pillow is
        not installed.
    IntegrityError, MissingFileError, StorageError
        As everywhere; no file is written.
    """
    if path.suffix.lower() != ".mp4":
        raise InputError(f"{path} is not an MP4 file", hint=f"write --mp4 {path.with_suffix('.mp4')}", path=str(path))
    try:
        import av
    except ImportError as error:
        raise InputError("films need PyAV, which is not installed", hint=install("rema[video]")) from error
    pillow()
    from evaluator.render.film import SHOT_EVERY, FilmMaker
    from evaluator.render.studio import Studio

    progress = progress or Silent()
    place = viewer.place(name)
    steps = [step for step in viewer.source.steps(place) if step.row["action"] is not None]
    if not steps:
        raise InputError(f"no step of {name} has an action", hint="choose another episode")
    rate = Fraction(round(1 / WORLD.time_step_s), SHOT_EVERY * _SHOTS)
    to_frame: Any = av.VideoFrame.from_image  # PyAV does not declare its type
    buffer = io.BytesIO()
    frames = 0
    progress.phase("film", len(steps))
    with FilmMaker() as films, Studio() as studio, av.open(buffer, "w", format="mp4") as container:
        stream: Any = container.add_stream("libx264", rate)
        stream.width, stream.height = SIZE
        stream.pix_fmt = "yuv420p"
        for _, take in takes(viewer.source, place, steps, films, progress):
            for picture, count in _pictures(studio, take, name, rate):
                for _ in range(count):
                    container.mux(stream.encode(to_frame(picture)))
                frames += count
                check()
            progress.advance(1)
        container.mux(stream.encode())
    write_atomic(path, buffer.getvalue())
    return frames


def _pictures(studio: Studio, take: Take, name: str, rate: Fraction) -> Iterator[tuple[Image.Image, int]]:
    """The pictures of a step, and how many frames each of them stands."""
    situation = take.situation
    said = f"{name}, step {situation.step + 1}: {situation.kind.primitive} with {KINDS[situation.kind].acting}"
    yield _drawn(studio, take, take.before, said), round(_BEFORE_S * rate)
    for shot in take.shots[:-1:_SHOTS]:
        yield _drawn(studio, take, shot, said), 1
    yield _drawn(studio, take, take.after, said, ended=True), round(_AFTER_S * rate)


def _drawn(studio: Studio, take: Take, shot: Any, said: str, ended: bool = False) -> Image.Image:
    from evaluator.render.film import markers

    _, draw_module = pillow()
    picture = studio.picture(shot, markers(take.situation, take.action), SIZE)
    pen = draw_module.Draw(picture)
    pen.rectangle((0, SIZE[1] - 26, *SIZE), fill="white")
    write_text(pen, (10, SIZE[1] - 22), said, 15, INK)
    if ended:
        colour = GREEN if take.outcome.success else RED
        write_text(pen, (SIZE[0] - 10, SIZE[1] - 22), outcome_text(to_dict(take.outcome)), 15, colour, "ra")
    return picture
