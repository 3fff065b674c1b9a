"""The laws of the balanced sampler: counts, order, repeats, ranks, and clear refusals."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from itertools import islice
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from rema_data.errors import InputError
from rema_data.samplers import BalancedSampler
from rema_data.samplers.batch_plan import ExactPlan
from tests.rema_data.samplers.datasets import Rows
from tests.rema_data.samplers.tables import TASKS, golden_digest, labels_of, table, uneven

GOLDEN = {
    "cycle": "4e57fb4fe3f99df3",
    "average": "868020e7292b23a6",
}


def epochs(sampler: BalancedSampler, count: int) -> list[np.ndarray]:
    return [batch for _ in range(count) for batch in sampler]


def rows_of(batches: list[np.ndarray]) -> np.ndarray:
    return np.concatenate(batches)


def code_of(sampler: BalancedSampler, rows: np.ndarray) -> np.ndarray:
    return np.asarray(sampler.strata.codes[rows])


def test_every_batch_has_one_of_each() -> None:
    columns = uneven()
    sampler = BalancedSampler(columns, batch_size=8, num_samples=80_000)
    batches = list(sampler)
    assert len(batches) == len(sampler) == 10_000
    everything = {(task, won) for task in TASKS for won in (True, False)}
    assert all(set(labels_of(columns, batch)) == everything for batch in batches[:500])
    codes = code_of(sampler, np.stack(batches))
    assert (np.sort(codes, axis=1) == np.arange(8)).all()


def test_eight_over_three_rotates_and_is_exact_over_time() -> None:
    columns = {"task": np.repeat(["a", "b", "c"], [5, 50, 500])}
    sampler = BalancedSampler(columns, batch_size=8, by="task", num_samples=8 * 300)
    counts = np.stack([np.bincount(code_of(sampler, batch), minlength=3) for batch in sampler])
    assert {tuple(sorted(row)) for row in counts.tolist()} == {(2, 3, 3)}
    assert (counts.sum(0) == 800).all()


shares = st.lists(st.floats(0.02, 1.0), min_size=2, max_size=9)


@settings(max_examples=30, deadline=None)
@given(shares, st.integers(1, 40))
def test_counts_stay_within_one_of_the_share(weights: list[float], batch: int) -> None:
    """In every batch the share rounded up or down; over any time less than one draw off."""
    plan = ExactPlan(np.array(weights) / sum(weights), batch)
    assert np.abs(plan.shares - np.array(weights) / sum(weights)).max() < 1e-3
    labels = plan.labels(0, 120)
    counts = np.stack([np.bincount(row, minlength=len(weights)) for row in labels])
    assert (counts.cumsum(0)[-1] == plan.before(120)).all()
    ideal = plan.shares * batch
    assert (counts >= np.floor(ideal - 1e-9)).all()
    assert (counts <= np.ceil(ideal + 1e-9)).all()
    assert (counts.sum(1) == batch).all()
    owed = np.arange(1, len(counts) + 1)[:, None] * ideal - counts.cumsum(0)
    assert np.abs(owed).max() < 1


def test_average_mode_follows_the_shares() -> None:
    columns = uneven()
    sampler = BalancedSampler(columns, 8, mode="average", num_samples=80_000, seed=3)
    batches = list(sampler)
    codes = code_of(sampler, rows_of(batches))
    expected = sampler._plan.shares * len(codes)
    assert stats.chisquare(np.bincount(codes), expected).pvalue > 0.001
    held = Counter(np.bincount(codes.reshape(-1, 8)[:, 0]).tolist())
    assert len(held) > 1
    counts = np.bincount(codes.reshape(-1, 8)[:2000].ravel() + 8 * np.arange(2000).repeat(8), minlength=16_000)
    assert counts.max() >= 4  # a batch is not exact


def test_orders_of_a_small_stratum_are_equally_likely() -> None:
    sampler = BalancedSampler({"task": np.zeros(4, int)}, 4, by="task", num_samples=4 * 4800)
    orders = Counter(tuple(batch) for batch in sampler)
    assert len(orders) == 24
    assert stats.chisquare(list(orders.values())).pvalue > 0.001


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.integers(1, 30), min_size=2, max_size=5),
    st.integers(1, 12),
    st.integers(1, 90),
    st.sampled_from(["exact", "average"]),
)
def test_every_row_before_any_repeat_across_epochs(sizes: list[int], batch: int, draws: int, mode: Any) -> None:
    columns = {"task": np.arange(len(sizes)).repeat(sizes)}
    draws = max(draws, batch)
    sampler = BalancedSampler(columns, batch, by="task", mode=mode, num_samples=draws, rotate=True)
    counts = np.zeros(sum(sizes), int)
    for batch_rows in epochs(sampler, 4):
        np.add.at(counts, batch_rows, 1)
        for rows in sampler.strata.rows:
            assert np.ptp(counts[rows]) <= 1
    assert counts.sum() == 4 * (draws // batch * batch)


def test_epoch_lengths() -> None:
    columns = {"task": np.repeat(["a", "b"], [10, 90])}
    assert len(BalancedSampler(columns, 4, by="task")) == 25
    assert len(BalancedSampler(columns, 4, by="task", num_samples=50)) == 12


def test_shares_of_tasks_stay_equal_when_a_label_is_missing() -> None:
    columns = table({("a", True): 5, ("a", False): 40, ("b", False): 20})
    sampler = BalancedSampler(columns, 8, on_empty="renormalise")
    assert sampler._plan.shares.tolist() == [0.25, 0.25, 0.5]
    assert sampler.strata.labels == (("a", False), ("a", True), ("b", False))


@pytest.mark.parametrize("mode", ["exact", "average"])
def test_a_task_has_the_share_that_it_is_given(mode: Any) -> None:
    """Three draws for one of each other task, and its successes and failures still have equal shares."""
    columns = uneven()
    sampler = BalancedSampler(columns, 12, mode=mode, num_samples=12 * 400, shares={"push": 3})
    counts = np.bincount(code_of(sampler, rows_of(list(sampler))), minlength=8) / (12 * 400)
    wanted = [(3 if label[0] == "push" else 1) / 12 for label in sampler.strata.labels]
    assert np.abs(counts - wanted).max() < (1e-9 if mode == "exact" else 0.03)
    with pytest.raises(InputError, match="target: 'uniform' here"):
        BalancedSampler(columns, 12, mode=mode, num_samples=12 * 400).load_state_dict(sampler.state_dict())


@pytest.mark.parametrize("mode", ["exact", "average"])
def test_ranks_share_one_global_batch(mode: Any) -> None:
    """The union over ranks is the same for every number of ranks, and each rank has its part of every stratum."""
    columns = uneven()
    options: dict[str, Any] = {"mode": mode, "num_samples": 24 * 9 + 12}
    alone = epochs(BalancedSampler(columns, 24, **options), 2)
    for world in (2, 3, 4, 8):
        ranks = [BalancedSampler(columns, 24 // world, rank=r, world_size=world, **options) for r in range(world)]
        assert {len(sampler) for sampler in ranks} == {len(alone) // 2}
        dealt = [epochs(sampler, 2) for sampler in ranks]
        for number, batch in enumerate(alone):
            parts = [batches[number] for batches in dealt]
            assert sorted(rows_of(parts).tolist()) == sorted(batch)
            if mode == "exact":
                counts = np.stack([np.bincount(code_of(ranks[0], part), minlength=8) for part in parts])
                assert np.ptp(counts, axis=0).max() <= 1
                assert np.ptp([len(part) for part in parts]) <= 1


def test_no_rank_keeps_a_stratum_for_itself() -> None:
    columns = {"task": np.repeat(["a", "b"], [10, 90])}
    sampler = BalancedSampler(columns, 1, by="task", rank=0, world_size=2)
    assert set(code_of(sampler, rows_of(list(islice(sampler, 10)))).tolist()) == {0, 1}


@pytest.mark.parametrize("mode", GOLDEN)
def test_golden_order(mode: str) -> None:
    """The order is part of what a seed means: it may change only with a new version of the state."""
    assert golden_digest(mode) == GOLDEN[mode]


def test_a_new_process_draws_the_same() -> None:
    code = "from tests.rema_data.samplers.tables import golden_digest; print(golden_digest('cycle'))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == GOLDEN["cycle"]


def test_epochs_and_seeds_differ() -> None:
    columns = uneven()
    first, second = (tuple(rows_of(list(sampler)).tolist()) for sampler in [BalancedSampler(columns, 8)] * 2)
    other = tuple(rows_of(list(BalancedSampler(columns, 8, seed=1))).tolist())
    assert len({first, second, other}) == 3


def test_global_random_state_is_neither_read_nor_changed() -> None:
    columns = uneven()
    np.random.seed(1)  # noqa: NPY002
    torch.manual_seed(1)
    states = np.random.get_state()[1].tolist(), torch.get_rng_state().tolist()  # type: ignore[index,union-attr] # noqa: NPY002
    first = rows_of(list(BalancedSampler(columns, 8)))
    after = np.random.get_state()[1].tolist(), torch.get_rng_state().tolist()  # type: ignore[index,union-attr] # noqa: NPY002
    assert after == states
    np.random.seed(2)  # noqa: NPY002
    torch.manual_seed(2)
    assert (rows_of(list(BalancedSampler(columns, 8))) == first).all()


def test_shuffled_table_is_balanced_too() -> None:
    columns = uneven()
    order = np.random.default_rng(5).permutation(len(columns["task"]))
    shuffled = {name: values[order] for name, values in columns.items()}
    sampler = BalancedSampler(shuffled, 8)
    for batch in sampler:
        assert len(set(labels_of(shuffled, batch))) == 8


@pytest.mark.parametrize("kind", ["dataset", "frame", "categories", "mapping of lists", "arrow strings"])
def test_kinds_of_tables(kind: str) -> None:
    columns = uneven()
    frame = pd.DataFrame(columns)
    made = {
        "dataset": Rows(columns),
        "frame": frame,
        "categories": frame.astype({"task": pd.CategoricalDtype([*reversed(TASKS), "unused"])}),
        "mapping of lists": {name: values.tolist() for name, values in columns.items()},
        "arrow strings": frame.astype({"task": "string[pyarrow]", "success": "boolean"}),
    }[kind]
    expected = rows_of(list(BalancedSampler(columns, 8)))
    assert (rows_of(list(BalancedSampler(made, 8))) == expected).all()


@pytest.mark.slow
def test_more_rows_than_float32_can_count() -> None:
    rows = 2**24 + 1000
    columns = {"task": (np.arange(rows) % 5).astype(np.int8), "success": np.arange(rows) % 7 == 0}
    sampler = BalancedSampler(columns, 250)
    drawn = rows_of(list(islice(sampler, 40)))
    assert (np.bincount(code_of(sampler, drawn), minlength=10) == 1000).all()
    assert drawn.max() > 2**24 - 2**22
    sampler.set_epoch(1000)
    assert len(next(iter(sampler))) == 250


@pytest.mark.slow
def test_twenty_million_rows() -> None:
    rows = 20_000_000
    columns = {"task": (np.arange(rows) % 4).astype(np.int8), "success": np.arange(rows) % 11 == 0}
    sampler = BalancedSampler(columns, 256, num_samples=10**9)
    drawn = rows_of(list(islice(sampler, 2000)))
    assert np.ptp(np.bincount(code_of(sampler, drawn))) == 0
    scarce = sampler.strata.rows[1]
    assert np.bincount(drawn).max() == 1
    assert np.isin(drawn, scarce).sum() == len(drawn) // 8


def test_report() -> None:
    columns = table({("a", True): 5, ("a", False): 95})
    report = BalancedSampler(columns, 10, num_samples=1000).describe()
    won = report.strata[1]
    assert (won.stratum, won.rows, won.natural, won.target) == ("task=a, success=True", 5, 0.05, 0.5)
    assert (won.draws, won.repeats, won.weight) == (500, 100, 0.1)
    (warning,) = report.warnings
    assert "5 rows of task=a, success=True" in warning
    assert warning in str(report)
    assert BalancedSampler(columns, 10).describe().warnings == ()
    assert report.to_frame().draws.sum() == 1000


def refused(match: str, columns: Any = None, **arguments: Any) -> InputError:
    with pytest.raises(InputError, match=match) as caught:
        BalancedSampler(uneven() if columns is None else columns, **{"batch_size": 8, **arguments})
    assert caught.value.hint
    return caught.value


def test_a_stratum_without_rows_is_named() -> None:
    columns = table({("a", True): 5, ("a", False): 5, ("b", False): 5})
    error = refused("task=b, success=True has no rows", columns)
    assert error.facts["strata"] == ("task=b, success=True",)
    refused("success=True has no rows", {"success": np.zeros(9, bool)}, by="success")
    frame = pd.DataFrame({"task": ["a"] * 4, "round": [1, 2, 2, 2], "success": [True, True, False, False]})
    refused("task=a, round=1, success=False has no rows", frame, by=("task", "round", "success"))


def test_combinations_that_never_occur_are_no_strata() -> None:
    columns = {"task": np.array(["a", "a", "b", "b"]), "round": np.array([1, 2, 1, 1])}
    assert len(BalancedSampler(columns, 3, by=("task", "round")).strata.labels) == 3
    columns["round"] -= 1  # numbers, even if they are 0 and 1
    assert BalancedSampler(columns, 3, by=("task", "round")).strata.labels == (("a", 0), ("a", 1), ("b", 0))


def test_a_batch_smaller_than_the_strata() -> None:
    error = refused("batch of 4 cannot hold each of 8 strata", batch_size=4)
    assert "rotate=True" in error.hint and 'mode="average"' in error.hint
    sampler = BalancedSampler(uneven(), 4, rotate=True)
    batches = list(islice(sampler, 8))
    assert all(len(set(code_of(sampler, batch).tolist())) == 4 for batch in batches)
    assert (np.bincount(code_of(sampler, rows_of(batches))) == 4).all()
    assert len(BalancedSampler(uneven(), 4, rank=0, world_size=2)) > 0


@pytest.mark.parametrize(
    ("match", "arguments"),
    [
        ("batch_size=0", {"batch_size": 0}),
        ("batch_size=True", {"batch_size": True}),
        ("batch_size=2.5", {"batch_size": 2.5}),
        ("seed=-1", {"seed": -1}),
        ("mode='best'", {"mode": "best"}),
        ("on_empty='skip'", {"on_empty": "skip"}),
        ("num_samples=0", {"num_samples": 0}),
        ("no column 'tusk'", {"by": ("tusk",)}),
        ("different columns", {"by": ("task", "task")}),
        ("different columns", {"by": ()}),
        ("rank 2 is outside of a world of 2", {"rank": 2, "world_size": 2}),
        ("belong together", {"rank": 0}),
        ("does not fill one batch", {"num_samples": 4}),
        (
            "too small for exact batches",
            {"columns": {"task": np.arange(20_000)}, "by": "task", "batch_size": 1, "rotate": True},
        ),
        ("no row has task=tusk", {"shares": {"tusk": 2}}),
        ("share of push is 0", {"shares": {"push": 0}}),
        ("share of push is inf", {"shares": {"push": float("inf")}}),
        ("share of push is '2'", {"shares": {"push": "2"}}),
        ("is not a table", {"columns": 5}),
        ("has no rows", {"columns": {"task": [], "success": []}}),
        ("missing values", {"columns": {"task": ["a", None], "success": [True, False]}}),
        ("differ in length", {"columns": {"task": ["a", "b"], "success": [True]}}),
        ("2 dimensions", {"columns": {"task": np.zeros((3, 2)), "success": [True] * 3}}),
        ("make 40,000 strata", {"columns": {"task": np.arange(40_000)}, "by": "task"}),
    ],
)
def test_refusals(match: str, arguments: dict[str, Any]) -> None:
    refused(match, **arguments)


def test_mixed_splits_are_refused() -> None:
    columns: dict[str, Any] = {**uneven(), "split": np.array(["train"] * len(uneven()["task"]))}
    BalancedSampler(columns, 8)
    columns["split"][3] = "val"
    refused("mixes the splits train, val", columns)


def test_import_needs_no_torch() -> None:
    code = (
        "import sys, rema_data.samplers as s; t = {'task': ['a'] * 4, 'success': [True, False] * 2}\n"
        "print(len(list(s.BalancedSampler(t, 2))), 'torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["2", "False"]
