"""Nothing that is drawn, stored or hashed depends on the order in which the tasks are listed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from evaluator.protocol import PROTOCOLS, protocol_hash
from evaluator.sim.spawn import collection_generator, draw_episode, episode_generator
from rema_data.schema import TASK_NUMBERS, TASKS, skill
from rema_data.store.block import BlockKey
from rema_data.testing import make_release, synthetic_episode


@contextmanager
def shuffled() -> Iterator[None]:
    """Tasks in another order, for everybody who holds the table."""
    before = dict(TASKS)
    try:
        for seed in (1, 2):
            TASKS.clear()
            TASKS.update({name: before[name] for name in np.random.default_rng(seed).permutation(sorted(before))})
            if list(TASKS) != list(before):
                break
        yield
    finally:
        TASKS.clear()
        TASKS.update(before)


def both(made: Callable[[], Any]) -> tuple[Any, Any]:
    """The same in the listed order and in another one."""
    first = made()
    with shuffled():
        assert list(TASKS) != list(TASK_NUMBERS)
        return first, made()


def test_scenarios_and_collection_streams_are_keyed_by_number() -> None:
    def drawn() -> list[Any]:
        return [
            draw_episode(rng, task)
            for task in sorted(TASKS)
            for n in range(3)
            for rng in (
                *(episode_generator(1, domain, task, n) for domain in ("test", "val", "collect", "calibrate")),
                *(collection_generator(1, 2, task, split, n) for split in ("train", "val")),
            )
        ]

    first, again = both(drawn)
    assert first == again
    assert len(set(first)) == len(first)


def test_blocks_lie_in_the_order_of_numbers(tmp_path: Path) -> None:
    folders = iter("ab")

    def sealed() -> list[str]:
        release = make_release(tmp_path / next(folders), tasks=("grasp_push", "push", "grasp"), episodes=3)
        return [block.key.path for block in release.manifest.blocks]

    first, again = both(sealed)
    assert first == again
    assert [path.split("/")[1] for path in first[::2]] == ["grasp", "push", "grasp_push"]


def test_protocols_skills_and_synthetic_episodes_stay() -> None:
    def seen() -> list[Any]:
        hashes = [protocol_hash(task, name) for task in sorted(TASKS) for name in PROTOCOLS]
        skills = [skill(kind) for task in sorted(TASKS) for kind in TASKS[task]]
        outcomes = [synthetic_episode(BlockKey(1, task, "train"), 5).steps[0].outcome for task in sorted(TASKS)]
        return [hashes, skills, outcomes]

    first, again = both(seen)
    assert first == again


def test_numbers_are_those_of_the_frozen_lists() -> None:
    """They may grow, and never change: every frozen scenario and every released episode was drawn with them."""
    frozen = {"grasp": 0, "push": 1, "grasp_grasp": 2, "grasp_push": 3, "grasp_grasp_push": 4}
    assert TASK_NUMBERS | frozen == TASK_NUMBERS
    assert len(set(TASK_NUMBERS.values())) == len(TASK_NUMBERS) == len(TASKS)
