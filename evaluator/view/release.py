"""A sealed release to browse: every episode of the blocks that are on this machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.compute as pc

from evaluator.view.source import Notice, Play, Seen, Source, StepRow
from evaluator.view.table import ID, EpisodeTable, Field
from rema_data.errors import IntegrityError, RemaError
from rema_data.interrupts import check
from rema_data.progress import Progress
from rema_data.release.folder import ReleaseFolder, find_release
from rema_data.release.manifest import BlockEntry
from rema_data.schema import EVIDENCE
from rema_data.store.block import EPISODES, STEPS, BlockReader
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS, VARIATION
from rema_data.store.tables import situation_of, variation_of

if TYPE_CHECKING:
    from evaluator.render.film import FilmMaker, Take

__all__ = ["ReleaseSource"]

_EPISODE = {
    "task": (True, False),
    "round": (True, False),
    "split": (True, False),
    "episode": (False, False),
    "failure": (True, False),
    "failed_step": (False, False),
    "steps": (False, True),
}
"""Columns of ``episodes.parquet`` that the table has: whether they are filtered, and listed."""
_LAST = {
    "policy": (True, True),
    "target_shape": (True, True),
    "tool0_shape": (True, True),
    "tool1_shape": (True, False),
    "pinch_shape": (True, False),
    "arm": (True, False),
}
"""Columns of ``steps.parquet``, taken from the last executed step of every episode: the one that decided it."""
_OUTCOME = Field("outcome", "success, or failed", filtered=True)
_CELL = Field("cell", "axis and level of the suites by which the last step is varied", filtered=True)
_VARIED = ["task", "round", "split", "episode", VARIATION]


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    entry: BlockEntry
    episodes: pa.Table
    steps: pa.Table
    first: int  # row of its first episode in the whole table


class ReleaseSource(Source):
    """See ``Source``."""

    def __init__(self, name_or_path: str | None, progress: Progress) -> None:
        self._folder = find_release(name_or_path)
        manifest = self._folder.manifest
        self.name, self.identity = manifest.name, manifest.sha256
        self._blocks, self.notices = _read(self._folder, progress)
        self.table = _table(self._blocks)
        self.facts = [
            ("release", manifest.title),
            ("sha256 of its manifest", manifest.sha256),
            ("folder", str(self._folder.path)),
            ("simulator", ", ".join(f"{name} {value}" for name, value in manifest.fingerprint.items())),
            ("licence", manifest.license),
        ]

    def _at(self, place: int) -> tuple[_Block, dict[str, Any]]:
        """The block of an episode, and its row in ``episodes.parquet``."""
        block = next(block for block in reversed(self._blocks) if block.first <= place)
        (row,) = block.episodes.slice(place - block.first, 1).to_pylist()
        return block, row

    def task(self, place: int) -> str:
        return self._at(place)[0].entry.task

    def steps(self, place: int) -> Sequence[StepRow]:
        block, head = self._at(place)
        rows = block.steps.slice(head["first_step"], head["steps"]).to_pylist()
        return [StepRow(row["step"], row) for row in rows]

    def seen(self, place: int, step: int, play: Play) -> Seen:
        from rema_data.gallery import steps_with_maps  # imports Zarr

        (block, head), row = self._at(place), self._row(place, step)
        (found,) = steps_with_maps(self._folder.block(block.entry), [row])
        return Seen(situation_of(row, variation_of(head)), found.observation)

    def take(self, place: int, step: int, films: FilmMaker) -> Take:
        row, variation = self._row(place, step), variation_of(self._at(place)[1])
        return films.take(situation_of(row, variation), row["action"])

    def _row(self, place: int, step: int) -> Any:
        return next(one.row for one in self.steps(place) if one.number == step)


def _read(folder: ReleaseFolder, progress: Progress) -> tuple[list[_Block], list[Notice]]:
    """The tables of all blocks that are here and whole; what is missing or damaged is a notice."""
    wanted, here = folder.manifest.blocks, folder.blocks()
    notices: list[Notice] = []
    if len(here) < len(wanted):
        try:
            folder.require(wanted)
        except RemaError as error:
            if not here:
                raise
            notices.append(Notice.of(error))
    blocks: list[_Block] = []
    damage: RemaError | None = None
    progress.phase("read", len(here))
    first = 0
    for entry in here:
        try:
            reader = folder.block(entry)
            block = _Block(entry, reader.episodes(), reader.steps(), first)
            _check_places(block, reader)
        except RemaError as error:
            damage = error
            notices.append(Notice(f"{entry.key.path} is not shown: {error.message}", error.hint))
        else:
            blocks.append(block)
            first += block.episodes.num_rows
        progress.advance(1)
        check()
    if not blocks and damage is not None:
        raise damage
    return blocks, notices


def _last_steps(block: _Block) -> pa.ChunkedArray:
    """Row in ``steps.parquet`` of the last executed step of every episode."""
    first, count = (block.episodes[name].cast(pa.int64()) for name in ("first_step", "steps"))
    return pc.subtract(pc.add(first, count), 1)


def _check_places(block: _Block, reader: BlockReader) -> None:
    """Raise IntegrityError where an episode names steps that are not there."""
    counts, last = pc.min_max(block.episodes["steps"]).as_py(), pc.min_max(_last_steps(block)).as_py()
    first = pc.min(block.episodes["first_step"]).as_py()
    if block.episodes.num_rows and (first < 0 or counts["min"] < 1 or last["max"] >= block.steps.num_rows):
        path = reader.folder / EPISODES
        raise IntegrityError(
            f"table {path} names steps that are not in {STEPS}", hint=reader.repair_hint(path), path=str(path)
        )


def _table(blocks: Sequence[_Block]) -> EpisodeTable:
    episodes = pa.concat_tables([block.episodes.select([*_EPISODE, "success"]) for block in blocks])
    wanted = [*_LAST, *EVIDENCE[1:]]
    steps = pa.concat_tables(block.steps.select(wanted).take(_last_steps(block)) for block in blocks)
    names = zip(*(episodes[name].to_pylist() for name in ("round", "task", "split", "episode")), strict=True)
    ids = pa.array([f"round-{number}/{task}/{split}/{index}" for number, task, split, index in names])
    outcome = pc.if_else(episodes["success"], "success", "failed")
    columns = {ID: ids, "outcome": outcome, **{name: steps[name] for name in wanted}}
    columns |= {name: episodes[name] for name in _EPISODE}
    fields = _fields()
    cells = [cell for block in blocks for cell in _cells(block.episodes)]
    if any(cells):
        columns[_CELL.name] = pa.array(cells)
        fields.append(_CELL)
    return EpisodeTable(fields, columns)


def _cells(episodes: pa.Table) -> list[str | None]:
    """Axis and level of every episode, None of a clean one."""
    if episodes[VARIATION].null_count == len(episodes):
        return [None] * len(episodes)
    found = map(variation_of, episodes.select(_VARIED).to_pylist())
    return [None if variation is None else variation.cell for variation in found]


def _fields() -> list[Field]:
    """Columns of the table; those of the release say what they said there."""
    known = {column.name: column for column in (*STEP_COLUMNS, *EPISODE_COLUMNS)}
    found = [Field(ID, "the episode: its block, and its number there"), _OUTCOME]
    for name, (filtered, listed) in (_EPISODE | _LAST).items():
        found.append(Field(name, known[name].meaning, known[name].unit, filtered, listed))
    found += [Field(name, known[name].meaning, known[name].unit) for name in EVIDENCE[1:]]
    order = [ID, "outcome", "task", "round", "split", "failure", "policy"]
    return sorted(found, key=lambda field: order.index(field.name) if field.name in order else len(order))
