"""Steps that are carried out again to be looked at: one simulator and one studio, made when they are first needed."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from evaluator.view.source import Source, StepRow
from rema_data.errors import InputError
from rema_data.repair import install

if TYPE_CHECKING:
    from evaluator.render.film import FilmMaker, Take
    from evaluator.render.studio import Studio

__all__ = ["Desk"]


class Desk:
    """Plays steps again, one after the other: all methods may be called by any thread, PyBullet may not."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._lock = threading.Lock()
        self._films: FilmMaker | None = None
        self._studio: Studio | None = None
        self._last: tuple[tuple[int, int], Take] | None = None

    def stills(self, place: int, step: StepRow) -> dict[str, Any]:
        """Photographs before and after a step, and whether it ended as it was recorded."""
        images = _images()
        with self._lock:
            take = self._take(place, step)
            before, after = images.stills(self._photographer(), take)
        again = "success" if take.outcome.failure is None else str(take.outcome.failure)
        return {"before": before, "after": after, "again": again, "agreement": _agreement(step, take)}

    def film(self, place: int, step: StepRow) -> dict[str, Any]:
        """A short animation of a step; null where no arm moved."""
        images = _images()
        with self._lock:
            return {"film": images.film(self._photographer(), self._take(place, step))}

    def take(self, place: int, step: StepRow) -> Take:
        """The step carried out again."""
        with self._lock:
            return self._take(place, step)

    def _take(self, place: int, step: StepRow) -> Take:
        """The step, carried out once for its photographs and its film."""
        key = (place, step.number)
        if self._last is None or self._last[0] != key:
            self._last = key, self._source.take(place, step.number, self._simulator())
        return self._last[1]

    def _simulator(self) -> FilmMaker:
        if self._films is None:
            from evaluator.render.film import FilmMaker
            from evaluator.sim.bullet import require_bullet

            require_bullet()
            self._films = FilmMaker()
        return self._films

    def _photographer(self) -> Studio:
        if self._studio is None:
            from evaluator.render.studio import Studio

            self._studio = Studio()
        return self._studio


def _images() -> Any:
    try:
        from evaluator.render import images
    except ImportError as error:
        raise InputError(f"pictures need {error.name}, which is not installed", hint=install("rema[report]")) from error
    return images


def _agreement(step: StepRow, take: Take) -> str:
    """How the step ended here against its record; an episode that went another way is different."""
    from evaluator.render.film import agreement

    if take.situation.step != step.number:
        return "different"
    return agreement({f"step{step.number}_{name}": value for name, value in step.row.items()}, take)
