"""From a name or a folder to what can be browsed."""

from __future__ import annotations

import os
from pathlib import Path

from evaluator.run.header import RUN_FILE
from evaluator.run.seal import SUMMARY_FILE
from evaluator.view.source import Source
from rema_data.errors import InputError, MissingFileError
from rema_data.progress import Progress, Silent
from rema_data.release.manifest import MANIFEST
from rema_data.release.registry import published

__all__ = ["open_source"]


def open_source(name_or_path: str | None = None, progress: Progress | None = None) -> Source:
    """The release of a published name, the release or the run in a folder; by default the newest release here.

    Raises
    ------
    InputError, MissingFileError
        There is nothing of that name, nothing to browse in the folder, or the run is not finished.
    IntegrityError
        The run or the manifest is damaged, or every block of the release that is here.
    """
    if name_or_path is not None:
        path = Path(os.path.expanduser(name_or_path))
        if (path / RUN_FILE).is_file() or (path / SUMMARY_FILE).is_file():
            from evaluator.view.run import RunSource

            return RunSource(path)
        if path.is_file():
            raise InputError(
                f"{path} is a file",
                hint="give the folder of a run or of a release; an entry of the leaderboard has no table to browse",
                path=str(path),
            )
        if path.is_dir() and not (path / MANIFEST).is_file() and name_or_path not in published():
            raise MissingFileError(
                f"{path} holds neither a sealed release nor a finished run",
                hint="name a release, the folder that `rema collect` or `rema download` made, or the run folder of a "
                "`rema evaluate`",
                path=str(path),
            )
    from evaluator.view.release import ReleaseSource

    return ReleaseSource(name_or_path, progress or Silent())
