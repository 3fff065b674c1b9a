"""Episodes back from the store: rows of the tables and maps of the cache as the record that the simulator emitted."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rema_data.heights import unpack_mask
from rema_data.schema import Episode, Observation, Situation, Step, StepOutcome
from rema_data.store.tables import action_of, outcome_of, situation_of, variation_of

if TYPE_CHECKING:
    import pyarrow as pa

    from rema_data.loader.cache import DecodedCache, MapArrays

__all__ = ["observation", "read_episode", "read_episodes"]

_PIECE = 256
"""Episodes whose rows are read at a time: a row alone takes ten times as long."""


def observation(maps: MapArrays, scene_row: int, ee_row: int) -> Observation:
    """What was observed, from its rows in the cache."""
    return Observation(
        maps.scene[scene_row].clip(0).astype("uint16"),  # edited maps may lie below the table, and the record may not
        maps.ee_depth[ee_row].clip(0).astype("uint16"),
        unpack_mask(maps.ee_mask[ee_row]),
    )


def read_episode(episodes: pa.Table, steps: pa.Table, position: int, cache: DecodedCache, first: int) -> Episode:
    """The episode in row ``position`` of a block's tables; ``first`` is where the block begins in the cache."""
    (head,) = episodes.slice(position, 1).to_pylist()
    return _episode(head, steps.slice(head["first_step"], head["steps"]).to_pylist(), cache, first)


def read_episodes(
    episodes: pa.Table, steps: pa.Table, cache: DecodedCache, first: int, chosen: npt.NDArray[np.bool_] | None = None
) -> Iterator[Episode]:
    """The episodes of a block in their order: all, or those with a ``chosen`` step."""
    for start in range(0, len(episodes), _PIECE):
        heads = episodes.slice(start, _PIECE).to_pylist()
        begin = heads[0]["first_step"]
        rows = steps.slice(begin, sum(head["steps"] for head in heads)).to_pylist()
        for head in heads:
            row = head["first_step"]
            if chosen is None or chosen[row : row + head["steps"]].any():
                yield _episode(head, rows[row - begin : row - begin + head["steps"]], cache, first)


def _episode(head: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], cache: DecodedCache, first: int) -> Episode:
    """An episode from its row and those of its steps."""
    places = cache.index[first + head["first_step"] :][: len(rows)]
    variation = variation_of(head)
    situations = [situation_of(row, variation) for row in rows]
    done = []
    for row, place, situation, following in zip(rows, places, situations, [*situations[1:], None], strict=True):
        seen = observation(cache.maps, int(place["scene_row"]), int(place["ee_row"]))
        outcome = _held(outcome_of(row), situation, following)
        done.append(Step(situation, seen, action_of(row), outcome, row["policy"], row["policy_digest"]))
    place = head["task"], head["round"], head["split"], head["episode"]
    return Episode(*place, head["seed"], tuple(done), variation)


def _held(outcome: StepOutcome, situation: Situation, following: Situation | None) -> StepOutcome:
    """The outcome with what it left in the hand: that is stored with the step that follows."""
    if following is None:
        return outcome
    grip = following.grips[-1] if len(following.grips) > len(situation.grips) else None
    return dataclasses.replace(outcome, grip=grip, pinch=following.pinch)
