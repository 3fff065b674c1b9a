"""Fresh lists: the distribution of the clean scenarios, from a seed that did not exist when a policy was written.

The frozen lists are public, so a table of actions solves them. A fresh list is drawn from a seed that somebody names
now: it lies below ``REMA_HOME``, and the same seed gives the same bytes everywhere. Its generators have a root of their
own, so no scenario is one of a frozen list, of a collection, or of another seed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import AbstractContextManager

from evaluator.scenarios.generation import Drawn, enter_list, generate_list, picked_list
from evaluator.scenarios.lists import (
    FRESH,
    installed_list,
    load_list,
    manifest_path,
)
from evaluator.scenarios.policy_picks import Picker
from rema_data.errors import InputError
from rema_data.locks import lock
from rema_data.progress import Progress, Silent
from rema_data.schema import pinch_step, tool_steps

__all__ = ["COUNT", "PICKER", "commitment", "draw_fresh", "fresh_version", "picked_by_policy"]

COUNT = 2_000
PICKER = ("tae", "rema-v0/round-2")
"""The policy that picked the tools of lists v2, and its networks below ``checkpoints``."""
_MOST = 2**63


def fresh_version(seed: int, count: int) -> str:
    """Name of a fresh list; InputError for a seed that is none."""
    if not 0 <= seed < _MOST:
        raise InputError(f"the seed {seed} is not in 0 .. {_MOST - 1}", hint="give another number to --fresh")
    return f"{FRESH}{seed}-{count}"


def _root(seed: int) -> int:
    return int.from_bytes(hashlib.sha256(f"rema fresh {seed}".encode()).digest())


def commitment(seed: int) -> str:
    """What an organiser publishes before an evaluation, and everybody can check when the seed is published: sha256."""
    return hashlib.sha256(f"rema fresh commitment {seed}".encode()).hexdigest()


def picked_by_policy(task: str) -> bool:
    """Whether a policy picks the tools of a task, as in lists v2; where something is pinched, the reference does."""
    return bool(tool_steps(task)) and pinch_step(task) is None


def draw_fresh(
    seed: int,
    task: str,
    count: int,
    pool: Executor,
    open_picker: Callable[[], AbstractContextManager[Picker]],
    progress: Progress | None = None,
) -> str:
    """The name of the fresh list of a seed, which is drawn where it is not here; ``open_picker`` picks its tools."""
    version, sink = fresh_version(seed, count), progress or Silent()
    manifest = manifest_path(version)
    manifest.parent.mkdir(parents=True, exist_ok=True)
    with lock(manifest.with_name(".lock"), wait=True):
        if installed_list(task, "test", version) is not None:
            load_list(task, "test", version)  # refuses one that was damaged
            return version
        sink.phase(f"draw {version}", count)
        drawn = []
        for one in _drawn(seed, task, count, pool, open_picker):
            drawn.append(one)
            sink.advance(1)
        enter_list(manifest, version, drawn, f"fresh {seed}")
    return version


def _drawn(
    seed: int, task: str, count: int, pool: Executor, open_picker: Callable[[], AbstractContextManager[Picker]]
) -> Iterator[Drawn]:
    if not picked_by_policy(task):
        yield from generate_list(task, "test", count, pool, _root(seed))
        return
    with open_picker() as picker:
        yield from picked_list(task, "test", count, pool, picker, _root(seed))
