"""The observation cache gives back exactly what was observed, and never trusts a damaged file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evaluator.rollout.ask import question
from evaluator.runner.observation_cache import ObservationCache
from evaluator.runner.questions import batches, shuffled
from rema_data.schema import Observation, Situation
from tests.evaluator.fakes import fake_backend, fake_observe, fake_scenario

SITUATIONS = tuple(fake_scenario("grasp_push", index).last_situation() for index in range(20))


class Counting:
    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, situation: Situation) -> Observation:
        self.calls += 1
        return fake_observe(situation)


@pytest.fixture
def seen() -> Counting:
    return Counting()


def same(cache: ObservationCache) -> bool:
    block = cache.load(SITUATIONS)
    for position, situation in enumerate(SITUATIONS):
        got, want = block.observation(position), fake_observe(situation)
        for name in ("scene", "depth", "mask"):
            a, b = getattr(got, name), getattr(want, name)
            if a.dtype != b.dtype or not np.array_equal(a, b):
                return False
    return True


def test_observed_once_and_read_exactly(tmp_path: Path, seen: Counting) -> None:
    cache = ObservationCache(tmp_path, seen, "code")
    assert cache.ensure(SITUATIONS)
    assert not cache.ensure(SITUATIONS)
    assert same(cache)
    assert seen.calls == len(SITUATIONS)
    assert len(cache.load(SITUATIONS).depths) == 1
    ObservationCache(tmp_path, seen, "other code").ensure(SITUATIONS)
    assert seen.calls == 2 * len(SITUATIONS)


@pytest.mark.parametrize("damage", ["flip", "cut", "empty", "gone", "size"])
def test_damaged_files_are_rebuilt(tmp_path: Path, seen: Counting, damage: str) -> None:
    cache = ObservationCache(tmp_path, seen, "code")
    cache.ensure(SITUATIONS)
    (path,) = tmp_path.rglob("*.obs")
    data = bytearray(path.read_bytes())
    data[-9] ^= 4
    if damage == "gone":
        path.unlink()
    else:
        if damage == "size":
            data[-9] ^= 4  # whole again: only the head of the file is wrong
            data[39] ^= 1
        path.write_bytes(data[: {"cut": -50, "empty": 0}.get(damage, len(data))])
    assert same(cache)
    assert seen.calls == 2 * len(SITUATIONS)
    assert not cache.ensure(SITUATIONS)


def test_a_question_holds_what_was_observed(tmp_path: Path) -> None:
    block = ObservationCache(tmp_path, fake_observe, "code").load(SITUATIONS)
    asked = question(fake_backend(), SITUATIONS[5:12], [block.observation(row) for row in range(5, 12)])
    assert asked.scene.dtype == asked.end_effector.dtype == np.float32
    for n, situation in enumerate(SITUATIONS[5:12]):
        want = fake_observe(situation)
        assert np.array_equal(asked.scene[n], want.scene_m())
        assert np.array_equal(asked.end_effector[n], want.end_effector())


@pytest.mark.parametrize(("size", "alive"), [(64, 1300), (7, 30), (600, 1000)])
def test_batches_are_fixed_by_position(size: int, alive: int) -> None:
    situations = {3 * n: SITUATIONS[n % 20] for n in range(alive)}
    found = batches(situations, size)
    assert [index for batch in found for index in batch.indices] == list(situations)
    assert {len(batch.indices) for batch in found[:-1]} == {size}
    for batch in found:
        assert batch.situations == tuple(situations[index] for index in batch.indices)


def test_questions_are_shuffled_by_the_salt_and_keep_their_companions() -> None:
    """What a resume has left to ask comes in the order that it had; scenarios that are asked together stay together."""
    situations = {n: fake_scenario("grasp", n).last_situation() for n in range(200)}
    found = batches(situations, 7)
    asked = shuffled(found, "salt")
    assert {frozenset(batch.indices) for batch in asked} == {frozenset(batch.indices) for batch in found}
    for batch in asked:
        assert batch.situations == tuple(situations[index] for index in batch.indices)
    order = [index for batch in asked for index in batch.indices]
    assert order != list(situations) and any(list(batch.indices) != sorted(batch.indices) for batch in asked)
    assert order != [index for batch in shuffled(found, "other") for index in batch.indices]
    left = [batch for batch in found if batch.indices[0] % 2]
    assert shuffled(left, "salt") == [batch for batch in asked if min(batch.indices) % 2]
