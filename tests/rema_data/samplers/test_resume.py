"""A run that stopped anywhere goes on exactly as if it had not, through every loader and on other world sizes."""

from __future__ import annotations

import json
import warnings
from itertools import chain, islice
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader
from torchdata.stateful_dataloader import StatefulDataLoader

from rema_data.errors import InputError
from rema_data.samplers import BalancedSampler
from tests.rema_data.samplers.datasets import Rows
from tests.rema_data.samplers.tables import uneven

MODES: dict[str, dict[str, Any]] = {
    "exact": {},
    "average": {"mode": "average"},
}


def made(mode: str = "exact", batch_size: int = 8, **arguments: Any) -> BalancedSampler:
    return BalancedSampler(uneven(), batch_size, **{"num_samples": 60} | MODES[mode] | arguments)


def lists(batches: Any, epochs: int = 1) -> list[list[int]]:
    """Batches of so many epochs, from wherever the sampler or loader stands."""
    return [np.asarray(batch).tolist() for _ in range(epochs) for batch in batches]


@pytest.mark.parametrize("mode", MODES)
def test_resume_at_every_position(mode: str) -> None:
    expected = lists(made(mode), 3)
    length = len(made(mode))
    sampler = made(mode)
    states = []
    for _ in range(2):
        for _ in sampler:
            states.append(json.loads(json.dumps(sampler.state_dict())))
    assert len(states) == 2 * length
    for position, state in enumerate(states, 1):
        again = made(mode)
        again.load_state_dict(state)
        passes = 3 - position // length  # what is left of this epoch is a pass of its own
        assert lists(again, passes) == expected[position:]
        assert again.epoch == 2


@pytest.mark.parametrize("mode", ["exact", "average"])
@pytest.mark.parametrize(("before", "after"), [(1, 4), (4, 2), (2, 8), (8, 1)])
def test_resume_on_another_world_size(mode: str, before: int, after: int) -> None:
    def ranks(world: int) -> list[BalancedSampler]:
        return [made(mode, 24 // world, num_samples=240, rank=rank, world_size=world) for rank in range(world)]

    expected = [sorted(batch) for batch in lists(ranks(1)[0], 2)]
    stopped = ranks(before)
    for sampler in stopped:
        list(islice(sampler, 7))
    states = [sampler.state_dict() for sampler in stopped]
    assert len({json.dumps(state) for state in states}) == 1
    going_on = ranks(after)
    for sampler in going_on:
        sampler.load_state_dict(states[0])
    parts = [lists(sampler, 2) for sampler in going_on]
    assert [sorted(chain(*batch)) for batch in zip(*parts, strict=True)] == expected[7:]


def test_a_later_position_costs_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """No draw before the position is made again, in either mode."""
    import rema_data.samplers.batch_plan as plans
    import rema_data.samplers.row_order as walks

    made_bits: list[int] = []
    original = walks.bits

    def counted(key: Any, first: int, count: int) -> Any:
        made_bits.append(count)
        return original(key, first, count)

    for mode in ("exact", "average"):
        sampler = made(mode, num_samples=8 * 50_000)
        list(islice(sampler, 40_000))
        state = sampler.state_dict() | {"epoch": 10**6} if mode == "exact" else sampler.state_dict()
        again = made(mode, num_samples=8 * 50_000)
        again.load_state_dict(state)
        made_bits.clear()
        with monkeypatch.context() as patched:
            patched.setattr(plans, "bits", counted)
            patched.setattr(walks, "bits", counted)
            next(iter(again))
        assert sum(made_bits) < 4 * 2**15


def test_a_left_epoch_is_not_repeated() -> None:
    expected = lists(made(), 3)
    sampler = made()
    length = len(sampler)
    assert lists(islice(sampler, 3)) == expected[:3]
    assert lists(sampler) == expected[length : 2 * length]
    assert sampler.epoch == 1
    sampler.set_epoch(0)
    assert lists(sampler) == expected[:length]
    sampler.set_epoch(2)
    assert lists(sampler) == expected[2 * length :]


def test_set_epoch_keeps_a_resumed_position() -> None:
    expected = lists(made(), 2)
    sampler = made()
    list(islice(sampler, 3))
    again = made()
    again.load_state_dict(sampler.state_dict())
    again.set_epoch(0)
    assert lists(again) == expected[3 : len(made())]
    with pytest.raises(InputError, match="negative"):
        again.set_epoch(-1)


def no_advice_about_workers() -> None:
    warnings.filterwarnings("ignore", message="This DataLoader will create")


@pytest.mark.parametrize(
    ("workers", "context"),
    [(0, None), (2, "fork"), (4, "fork"), pytest.param(2, "spawn", marks=pytest.mark.slow)],
)
def test_torch_loader_draws_ahead_and_resumes_by_what_was_consumed(workers: int, context: str | None) -> None:
    no_advice_about_workers()
    expected = lists(made(), 2)

    def loader(sampler: BalancedSampler) -> DataLoader[torch.Tensor]:
        data = Rows(uneven())
        return DataLoader(data, batch_sampler=sampler, num_workers=workers, multiprocessing_context=context)

    assert lists(loader(made()), 2) == expected
    sampler = made()
    for number, _ in enumerate(loader(sampler), 1):
        if number == 3:
            break
    assert sampler.step == (3 if workers == 0 else min(3 + 2 * workers, len(sampler)))
    state = sampler.state_dict(consumed=3)
    for position in (4, 5):  # resumed twice: consumed counts from where the pass began
        again = made()
        again.load_state_dict(state)
        batches = iter(loader(again))
        assert lists([next(batches)]) == [expected[position - 1]]
        state = again.state_dict(consumed=1)
        del batches
    again = made()
    again.load_state_dict(state)
    assert lists(loader(again), 2) == expected[5:]


def test_consumed_is_checked() -> None:
    sampler = made()
    list(islice(sampler, 3))
    assert sampler.state_dict(consumed=3) == sampler.state_dict()
    for consumed in (-1, 4):
        with pytest.raises(InputError, match="handed out 3"):
            sampler.state_dict(consumed=consumed)


@pytest.mark.filterwarnings("ignore:'set_vital' is deprecated")  # torchdata 0.11 calls it
@pytest.mark.parametrize(("mode", "workers"), [("exact", 0), ("average", 0), ("average", 2), ("exact", 2)])
def test_stateful_loader_resumes_exactly(mode: str, workers: int) -> None:
    expected = lists(made(mode), 3)
    length = len(made(mode))

    def loader() -> StatefulDataLoader[torch.Tensor]:
        return StatefulDataLoader(Rows(uneven()), num_workers=workers, batch_sampler=made(mode))

    first = loader()
    assert lists(first, 3) == expected
    first = loader()
    states = [first.state_dict()]  # before anything was drawn
    for _ in range(2):
        for _ in first:
            states.append(first.state_dict())
        states.append(first.state_dict())  # after the end of an epoch
    positions = [0, *range(1, length + 1), length, *range(length + 1, 2 * length + 1), 2 * length]
    kept = range(len(states)) if workers == 0 else (0, 1, length, length + 1, len(states) - 1)
    for number in kept:
        again = loader()
        again.load_state_dict(states[number])
        got: list[list[int]] = []
        while len(got) < 3 * length - positions[number]:
            got += lists(again)
        assert got == expected[positions[number] :]


def test_state_of_something_else_is_refused() -> None:
    state = made().state_dict()
    cases: dict[str, BalancedSampler] = {
        "seed: 1 here, 0 in the state": made(seed=1),
        "global batch: 16 here, 8 in the state": made(batch_size=16),
        "mode: 'average' here, 'exact' in the state": made("average"),
        "dataset: 'rows' here": BalancedSampler(Rows(uneven()), 8, num_samples=60),
        "dataset: ": BalancedSampler(uneven(rare=8), 8, num_samples=60),
        "whole batches: 8 here, 7 in the state": made(num_samples=64),
    }
    for message, sampler in cases.items():
        with pytest.raises(InputError, match=message) as caught:
            sampler.load_state_dict(state)
        assert caught.value.facts["differences"]
        assert (sampler.epoch, sampler.step) == (0, 0)


@pytest.mark.parametrize(
    ("match", "change"),
    [
        ("version 1", {"version": 2}),
        ("no settings", {"settings": None}),
        ("not a position", {"epoch": -1}),
        ("not a position", {"batch": 8}),
        ("not a position", {"batch": "1"}),
        ("not a position", {"batch": 7, "row": 1}),
        ("not a position", {"row": 2}),
    ],
)
def test_damaged_states_are_refused(match: str, change: dict[str, Any]) -> None:
    sampler = made()
    list(islice(sampler, 3))
    with pytest.raises(InputError, match=match):
        made().load_state_dict(sampler.state_dict() | change)


def test_more_damaged_states() -> None:
    for nothing in ({}, None, [1]):
        with pytest.raises(InputError, match="not a state of a sampler"):
            made().load_state_dict(nothing)  # type: ignore[arg-type]
    state = made("average").state_dict()
    for anchor in ([1, [1] * 8], [0, [0] * 7], [0, [1, -1, 0, 0, 0, 0, 0, 0]], [], [10**6, [125_000] * 8]):
        with pytest.raises(InputError, match="counts in the state are damaged"):
            made("average").load_state_dict(state | {"anchor": anchor})


def test_a_state_of_an_earlier_rema_goes_on() -> None:
    """As version 0.1.0 wrote it, with the settings that could be chosen then."""
    expected = lists(made(), 2)
    settings = {"by": ["task", "success"], "target": "uniform", "mode": "exact", "replacement": "cycle"}
    settings |= {"global batch": 8, "whole batches": 7, "rows of a shorter batch": 0, "seed": 0, "strata": 8}
    settings |= {"dataset": made().fingerprint}
    sampler = made()
    sampler.load_state_dict({"version": 1, "epoch": 0, "batch": 3, "row": 0, "world_size": 1, "settings": settings})
    assert lists(sampler, 2) == expected[3:]
