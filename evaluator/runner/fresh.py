"""The fresh list of a seed, drawn where it is not on this machine."""

from __future__ import annotations

from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from pathlib import Path

from evaluator.engines import default_workers
from evaluator.engines.child import process_pool
from evaluator.policy.loading import resolve
from evaluator.policy.shipped import CHECKPOINTS
from evaluator.rollout.picks import open_picker
from evaluator.scenarios.fresh import PICKER, draw_fresh
from evaluator.scenarios.policy_picks import Picker
from rema_data.errors import InputError, MissingFileError
from rema_data.progress import Progress
from rema_data.release.folder import downloads_folder, local_sources
from rema_data.storage import rema_home

__all__ = ["fresh_list"]


def fresh_list(seed: int, task: str, count: int, workers: int | None, progress: Progress | None = None) -> str:
    """The version of the lists that a seed names; its list of a task is drawn where it is not on this machine.

    Raises InputError for a seed that is none, and where the calling program cannot start processes; MissingFileError
    where the networks that pick tools are not here.
    """
    processes = workers or default_workers()

    def picker() -> AbstractContextManager[Picker]:
        log = rema_home() / "logs" / "fresh.log"
        log.parent.mkdir(parents=True, exist_ok=True)
        return open_picker(resolve(PICKER[0]), _networks(), "cpu", log, processes)

    try:
        return draw_fresh(seed, task, count, lambda: process_pool(processes), picker, progress)
    except BrokenProcessPool as error:
        raise InputError(
            "the processes that draw a fresh list ended before they had begun",
            hint='call evaluate() below `if __name__ == "__main__":`, since each of them imports your program; or '
            f"draw the list once with `rema evaluate random --task {task} --fresh {seed} --episodes {count}`",
        ) from error


def _networks() -> Path:
    places = [root / CHECKPOINTS / PICKER[1] for root in (downloads_folder(), *local_sources())]
    for place in places:
        if place.is_dir():
            return place.resolve()
    raise MissingFileError(
        f"the networks that pick the tools of a fresh list ({PICKER[1]}) are not on this machine",
        hint="run it in a clone of the repository, which has them under releases/checkpoints",
        searched=[str(place) for place in places],
    )
