"""Steps that are played again for several requests at once: PyBullet is used by one thread at a time."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from evaluator.sim.observation import observe
from evaluator.view import Viewer
from evaluator.view.source import Play, Seen, Source, StepRow
from evaluator.view.table import EpisodeTable
from rema_data.schema import Situation


class OneAtATime(Source):
    """The release, with steps whose start is known only once they were played again, as in an end-to-end run."""

    identity, facts, notices = "0" * 64, (), ()

    def __init__(self, source: Source) -> None:
        self.name, self.table, self.source = source.name, source.table, source
        self.inside = threading.Lock()
        self.taken: list[tuple[int, int]] = []

    table: EpisodeTable

    def task(self, place: int) -> str:
        return self.source.task(place)

    def steps(self, place: int) -> Sequence[StepRow]:
        return self.source.steps(place)

    def seen(self, place: int, step: int, play: Play) -> Seen:
        situation: Situation = play().situation
        return Seen(situation, observe(situation))

    def take(self, place: int, step: int, films: Any) -> Any:
        assert self.inside.acquire(blocking=False), "two threads play at once"
        self.taken.append((place, step))
        time.sleep(0.01)
        take = films.take(self.source.seen(place, step, lambda: take).situation, self.steps(place)[step].row["action"])
        self.inside.release()
        return take


def test_requests_of_many_threads_play_one_after_the_other(viewer: Viewer) -> None:
    source = OneAtATime(viewer.source)
    mine = Viewer(source)
    names = [row["id"] for row in viewer.rows("task=grasp", limit=4)["rows"]]
    asked = [(name, what) for name in names for what in ("scene", "ee1", "ee2")]
    with ThreadPoolExecutor(8) as pool:
        pictures = list(pool.map(lambda one: mine.picture(one[0], 0, one[1]), asked))
    assert all(picture.startswith(b"\x89PNG") for picture in pictures)
    assert {place for place, _ in source.taken} == {viewer.place(name) for name in names}


def test_a_step_is_played_once_for_its_photographs_and_its_maps(viewer: Viewer) -> None:
    source = OneAtATime(viewer.source)
    mine = Viewer(source)
    name = viewer.rows("task=grasp&q=arm=left")["rows"][0]["id"]
    mine.picture(name, 0, "scene")
    mine.stills(name, 0)
    assert len(source.taken) == 1
