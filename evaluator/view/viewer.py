"""What the page asks for: the table in pieces, an episode with its steps, maps, and steps that are played again.

Every answer is plain data, ready for JSON, or the bytes of a PNG file. The page writes all text as text, never as HTML.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

from evaluator.render.inlined import rema_version
from evaluator.render.words import FAILURES, measured_text, touching_text
from evaluator.sim.kinds import KINDS
from evaluator.sim.parameters import WORLD
from evaluator.view.desk import Desk
from evaluator.view.query import Query, parse_query
from evaluator.view.source import Seen, Source, StepRow
from evaluator.view.table import Selection
from rema_data.errors import InputError
from rema_data.pictures import LEGEND, action_text, end_effector_map, scene_map, to_png
from rema_data.schema import EVIDENCE, TASKS, StepKind
from rema_data.store.columns import STEP_COLUMNS

__all__ = ["LINK", "PICTURES", "Viewer"]

LINK = ("episode", "step")
"""Parameters of the page's address that name what is open, and not what is selected."""
PICTURES = ("scene", "ee1", "ee2")
"""Maps of a step: the scene with the action, and both states of the end effector."""
MOST_ROWS = 1000
"""Of one answer."""
_SCENE, _HAND = 384, 200
"""Width and height of a map on the page, pixels."""
_KNOWN = {column.name: column for column in STEP_COLUMNS}


class Viewer:
    """Answers about one release or one run; all methods may be called by any thread."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.desk = Desk(source)
        self._select = lru_cache(32)(source.table.select)
        self._seen = lru_cache(64)(self._look)
        self._png = lru_cache(512)(self._draw)

    def about(self) -> dict[str, Any]:
        """What is browsed: facts, notices, columns, and the words that the page needs."""
        source = self.source
        return {
            "name": source.name,
            "identity": source.identity,
            "rema": rema_version(),
            "episodes": len(source.table),
            "facts": [list(fact) for fact in source.facts],
            "notices": [{"error": notice.message, "hint": notice.hint} for notice in source.notices],
            "fields": source.table.describe(),
            "legend": [["#{:02x}{:02x}{:02x}".format(*colour), text] for colour, text in LEGEND],
        }

    def select(self, query: Query) -> Selection:
        """The episodes of a query; raises InputError where it names what is not there."""
        found: Selection = self._select(query)
        return found

    def rows(self, query: str, offset: int = 0, limit: int = 100, around: str | None = None) -> dict[str, Any]:
        """A piece of the table.

        Parameters
        ----------
        query : str
            See ``evaluator.view.query``.
        offset, limit : int
            Rows to skip, and how many to give, at most 1000.
        around : str, optional
            An episode: the piece is the one that has it, in place of ``offset``.

        Returns
        -------
        dict
            ``total`` rows of the query, ``offset`` and ``rows`` of the piece, ``position`` of ``around`` (null where
            the query does not select it), and ``counts`` of what every filter would leave.
        """
        found = self.select(parse_query(query, LINK))
        limit = max(1, min(limit, MOST_ROWS))
        position = None
        if around is not None:
            hits = (found.rows == self.place(around)).nonzero()[0]
            if len(hits):
                position = int(hits[0])
                offset = position // limit * limit
        chosen = found.rows[max(0, offset) :][:limit].tolist()
        table = self.source.table
        return {
            "total": len(found.rows),
            "offset": offset,
            "position": position,
            "rows": [table.row(place) for place in chosen],
            "counts": found.counts,
        }

    def place(self, name: str) -> int:
        """The row of an episode; raises InputError where there is no such one."""
        place = self.source.table.place(name)
        if place is None:
            ids = self.source.table.ids
            raise InputError(
                f"there is no episode {name!r} in {self.source.name}",
                hint=f"choose one of the list, such as {ids[0]}" if ids else "there is none at all",
            )
        return place

    def step(self, name: str, number: int) -> tuple[int, StepRow]:
        """A step of an episode, and the row of the episode; raises InputError where it was not executed."""
        place = self.place(name)
        steps = self.source.steps(place)
        for step in steps:
            if step.number == number:
                return place, step
        there = ", ".join(str(step.number) for step in steps)
        raise InputError(f"{name} has no step {number}", hint=f"its steps are, from 0: {there or 'none'}")

    def episode(self, name: str) -> dict[str, Any]:
        """An episode: its row, and what is recorded of every step."""
        place = self.place(name)
        kinds = TASKS[self.source.task(place)]
        steps = [_told(name, step, kinds) for step in self.source.steps(place)]
        return {"row": self.source.table.row(place), "of": len(kinds), "steps": steps}

    def picture(self, name: str, number: int, what: str) -> bytes:
        """A map of a step, one of ``PICTURES``, as a PNG file."""
        if what not in PICTURES:
            raise InputError(f"there is no picture {what!r}", hint=f"there are: {', '.join(PICTURES)}")
        place, step = self.step(name, number)
        if step.row["action"] is None:
            raise InputError(f"the policy gave no action in step {number + 1} of {name}", hint="choose another step")
        png: bytes = self._png(place, number, what)
        return png

    def stills(self, name: str, number: int) -> dict[str, Any]:
        """Photographs of a step that is played again (``data:`` URLs), and how it ended this time."""
        return self.desk.stills(*self._to_play(name, number))

    def film(self, name: str, number: int) -> dict[str, Any]:
        """A short animation of a step that is played again, as a ``data:`` URL."""
        return self.desk.film(*self._to_play(name, number))

    def _to_play(self, name: str, number: int) -> tuple[int, StepRow]:
        place, step = self.step(name, number)
        if step.row["action"] is None:
            raise InputError(f"the policy gave no action in step {number + 1} of {name}", hint="choose another step")
        return place, step

    def seen(self, name: str, number: int) -> Seen:
        """What a step started from."""
        place, _ = self.step(name, number)
        found: Seen = self._seen(place, number)
        return found

    def _look(self, place: int, number: int) -> Seen:
        step = next(step for step in self.source.steps(place) if step.number == number)
        return self.source.seen(place, number, lambda: self.desk.take(place, step))

    def _draw(self, place: int, number: int, what: str) -> bytes:
        seen = self._seen(place, number)
        if what != "scene":
            return to_png(end_effector_map(seen.observation, PICTURES.index(what) - 1, _HAND))
        row = next(step.row for step in self.source.steps(place) if step.number == number)
        way_m = KINDS[seen.situation.kind].reach_shifts(WORLD)[-1]
        goal_m = seen.situation.target.x_m + WORLD.push_success_m if way_m else None
        pose = row["x_m"], row["y_m"], row["theta_rad"]
        return to_png(scene_map(seen.observation, pose, way_m, goal_m, _SCENE))


def _told(name: str, step: StepRow, kinds: tuple[StepKind, ...]) -> dict[str, Any]:
    """A step in words and numbers."""
    kind, row, number = kinds[step.number], step.row, step.number
    title = f"step {number + 1} of {len(kinds)}" if len(kinds) > 1 else "the only step"
    act = f"{kind.primitive} with {KINDS[kind].acting}"
    label = row["failure"]
    action = None
    if row["action"] is not None:
        action = action_text((row["i"], row["j"], row["k"]), (row["x_m"], row["y_m"], row["theta_rad"]))
    measured = row["sim_steps"] is not None and action is not None
    return {
        "step": number,
        "title": f"{title}: {act}",
        "short": f"{number + 1} {kind.primitive}",
        "success": row["success"],
        "failure": label,
        "why": FAILURES.get(label, "") if label else "",
        "touching": touching_text(kind),
        "action": action,
        "measured": measured_text(kind, row) if measured else None,
        "evidence": [_cell(item, row[item]) for item in EVIDENCE if row[item] is not None],
        "columns": [_cell(item, value) for item, value in row.items() if value is not None and item not in EVIDENCE],
        "alt": f"Scene height map of step {number + 1} of {name}, {act}, at {action}",
    }


def _cell(name: str, value: Any) -> dict[str, Any]:
    column = _KNOWN.get(name)
    return {
        "name": name,
        "value": str(value) if isinstance(value, float) and not math.isfinite(value) else value,
        "unit": "" if column is None else column.unit,
        "meaning": "" if column is None else column.meaning,
    }
