"""What can be browsed: a sealed release or a finished run, behind one small interface."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from evaluator.view.table import EpisodeTable
from rema_data.errors import RemaError
from rema_data.progress import Progress
from rema_data.schema import Observation, Situation

if TYPE_CHECKING:
    from evaluator.render.film import FilmMaker, Take

__all__ = ["Notice", "Play", "Seen", "Source", "StepRow", "takes"]

Play = Callable[[], "Take"]
"""Carries a step out again, where that is needed."""


@dataclass(frozen=True, slots=True)
class Notice:
    """Something that the reader must know: what is wrong, and what fixes it."""

    message: str
    hint: str = ""

    @staticmethod
    def of(error: RemaError) -> Notice:
        """An error in the same words."""
        return Notice(error.message, error.hint)


@dataclass(frozen=True, slots=True)
class StepRow:
    """A step that was executed: its number, from 0, and what is recorded of it, by the names of a release's columns."""

    number: int
    row: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Seen:
    """What a step started from, and what the policy saw of it."""

    situation: Situation
    observation: Observation


class Source(ABC):
    """Episodes to browse; ``place`` is a row of the table. All methods may raise a RemaError about damage."""

    name: str  # in a few words
    identity: str  # a sha256: with it, what was drawn of an episode may be kept
    facts: Sequence[tuple[str, str]]
    notices: Sequence[Notice]
    table: EpisodeTable

    @abstractmethod
    def task(self, place: int) -> str:
        """The task of an episode."""

    @abstractmethod
    def steps(self, place: int) -> Sequence[StepRow]:
        """The steps that were executed, or that are recorded."""

    @abstractmethod
    def seen(self, place: int, step: int, play: Play) -> Seen:
        """What a step started from; the step was executed. ``play`` is ``take`` of this step."""

    @abstractmethod
    def take(self, place: int, step: int, films: FilmMaker) -> Take:
        """The step carried out again, or the earlier one at which the episode now ends."""


def takes(
    source: Source, place: int, steps: Sequence[StepRow], films: FilmMaker, progress: Progress
) -> Iterator[tuple[StepRow, Take]]:
    """Steps of an episode, each carried out again; with a note, only those up to where the episode now ends."""
    for step in steps:
        take = source.take(place, step.number, films)
        if take.situation.step != step.number:
            ends = f"played again here, {source.table.ids[place]} ends at step {take.situation.step + 1}"
            progress.note(f"{ends}: the later steps that are recorded are left out")
            return
        yield step, take
