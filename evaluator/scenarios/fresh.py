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
from evaluator.scenarios.lists import installed_list, load_list, manifest_path
from evaluator.scenarios.policy_picks import Picker
from evaluator.scenarios.seeds import fresh_version
from rema_data.locks import lock
from rema_data.progress import Progress, Silent
from rema_data.schema import pinch_step, tool_steps

__all__ = ["PICKER", "draw_fresh", "picked_by_policy"]

PICKER = ("tae", "rema-v0/round-2")
"""The policy that picked the tools of lists v2, and its networks below ``checkpoints``."""


def _root(seed: int) -> int:
    return int.from_bytes(hashlib.sha256(f"rema fresh {seed}".encode()).digest())


def picked_by_policy(task: str) -> bool:
    """Whether a policy picks the tools of a task, as in lists v2; where something is pinched, the reference does."""
    return bool(tool_steps(task)) and pinch_step(task) is None


def draw_fresh(
    seed: int,
    task: str,
    count: int,
    open_pool: Callable[[], AbstractContextManager[Executor]],
    open_picker: Callable[[], AbstractContextManager[Picker]],
    progress: Progress | None = None,
) -> str:
    """The name of the fresh list of a seed, which is drawn where it is not here; ``open_picker`` picks its tools."""
    version, sink = fresh_version(seed, count), progress or Silent()
    if _is_here(task, version):
        return version
    manifest = manifest_path(version)
    manifest.parent.mkdir(parents=True, exist_ok=True)
    # The pool first: where its processes run the user's script again, they would wait for a lock that this one holds.
    with open_pool() as pool, lock(manifest.with_name(".lock"), wait=True):
        if _is_here(task, version):
            return version
        sink.phase(f"draw {version}", count)
        drawn = []
        for one in _drawn(seed, task, count, pool, open_picker):
            drawn.append(one)
            sink.advance(1)
        enter_list(manifest, version, drawn, f"fresh {seed}")
    return version


def _is_here(task: str, version: str) -> bool:
    """Whether a list is on this machine; one that was damaged is refused."""
    if installed_list(task, "test", version) is None:
        return False
    load_list(task, "test", version)
    return True


def _drawn(
    seed: int, task: str, count: int, pool: Executor, open_picker: Callable[[], AbstractContextManager[Picker]]
) -> Iterator[Drawn]:
    if not picked_by_policy(task):
        yield from generate_list(task, "test", count, pool, _root(seed))
        return
    with open_picker() as picker:
        yield from picked_list(task, "test", count, pool, picker, _root(seed))
