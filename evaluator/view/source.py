"""What can be browsed: a sealed release or a finished run, behind one small interface."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from evaluator.run.header import RUN_FILE
from evaluator.run.seal import SUMMARY_FILE
from evaluator.view.table import EpisodeTable
from rema_data.errors import InputError, MissingFileError, RemaError
from rema_data.progress import Progress
from rema_data.release.manifest import MANIFEST
from rema_data.release.registry import published
from rema_data.schema import Observation, Situation

if TYPE_CHECKING:
    from evaluator.render.film import FilmMaker, Take

__all__ = ["Films", "Notice", "Seen", "Source", "StepRow", "open_source"]

Films = Callable[[], "FilmMaker"]
"""Gives what simulates steps; it is made when it is first needed."""


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


class Source(Protocol):
    """Episodes to browse; ``place`` is a row of the table. All methods may raise a RemaError about damage."""

    kind: str  # ``release`` or ``run``
    name: str  # in a few words
    identity: str  # a sha256: with it, what was drawn of an episode may be kept
    facts: Sequence[tuple[str, str]]
    notices: Sequence[Notice]
    table: EpisodeTable

    def task(self, place: int) -> str:
        """The task of an episode."""

    def steps(self, place: int) -> Sequence[StepRow]:
        """The steps that were executed, or that are recorded."""

    def seen(self, place: int, step: int, films: Films) -> Seen:
        """What a step started from; the step was executed."""

    def take(self, place: int, step: int, films: FilmMaker) -> Take:
        """The step carried out again, or the earlier one at which the episode now ends."""


def open_source(name_or_path: str | None, progress: Progress) -> Source:
    """The release of a published name, the release or the run in a folder; by default the newest release here.

    Raises
    ------
    InputError, MissingFileError
        There is nothing of that name, nothing to browse in the folder, or the run is not finished.
    IntegrityError
        The run or the manifest is damaged, or every block of the release that is here.
    """
    from evaluator.view.release import ReleaseSource
    from evaluator.view.run import RunSource

    if name_or_path is not None and name_or_path not in published():
        path = Path(name_or_path).expanduser()
        if path.is_file():
            raise InputError(
                f"{path} is a file",
                hint="give the folder of a run or of a release; an entry of the leaderboard has no table to browse",
                path=str(path),
            )
        if (path / RUN_FILE).is_file() or (path / SUMMARY_FILE).is_file():
            return RunSource(path)
        if path.is_dir() and not (path / MANIFEST).is_file():
            raise MissingFileError(
                f"{path} holds neither a sealed release nor a finished run",
                hint="name a release, the folder that `rema collect` or `rema download` made, or the run folder of a "
                "`rema evaluate`",
                path=str(path),
            )
    return ReleaseSource(name_or_path, progress)
