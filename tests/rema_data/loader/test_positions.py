"""A position means a step of one table: in any other it is refused, never another step."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest
from torch.utils.data import ConcatDataset, DataLoader, Subset

import rema_data
from rema_data.errors import InputError
from rema_data.loader.dataset import StepDataset
from rema_data.positions import Positions

BY = ("success",)


@pytest.fixture(scope="module")
def dataset(release: rema_data.Release) -> StepDataset:
    return release.steps(tasks=["grasp", "grasp_push"], split="train", which="all")


def sampler(table: Any, **options: Any) -> rema_data.BalancedSampler:
    return rema_data.BalancedSampler(table, 4, by=BY, **options)


def steps_of(table: pd.DataFrame, rows: Any) -> list[tuple[Any, ...]]:
    return [
        tuple(row) for row in table.iloc[list(rows)][["task", "round", "episode", "step"]].astype(object).to_numpy()
    ]


@pytest.mark.parametrize("workers", [0, 1])
def test_a_dataset_and_its_sampler(dataset: StepDataset, workers: int) -> None:
    for table in (dataset, dataset.table, dataset.table.set_index("task", drop=False), dataset.table[["success"]]):
        wanted = list(sampler(table))
        loader = DataLoader(dataset, batch_sampler=sampler(table), num_workers=workers)
        for batch, rows in zip(loader, wanted, strict=True):
            assert batch.index.tolist() == rows and sorted(batch.success.tolist()) == [False, False, True, True]


def test_relabelled_tables_are_served(dataset: StepDataset) -> None:
    """The labels are the user's: only which step a row is must not change."""
    table = dataset.table.assign(success=dataset.table.index % 2 == 0, task="all")
    for rows in sampler(table):
        assert sorted((dataset[rows].index % 2).tolist()) == [0, 0, 1, 1]


CHANGES: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    "picked": lambda table: table[table.task == "grasp"],
    "picked, numbered anew": lambda table: table[table.task == "grasp"].reset_index(drop=True),
    "queried": lambda table: table.query("step == 0"),
    "sorted": lambda table: table.sort_values(["success", "episode"]),
    "sorted, numbered anew": lambda table: table.sort_values(["success", "episode"], ignore_index=True),
    "shuffled": lambda table: table.sample(frac=1, random_state=0),
    "some columns of some rows": lambda table: table[["task", "success"]][table.task == "grasp"],
    "some columns, shuffled": lambda table: table[["task", "success"]].sample(frac=1, random_state=0),
    "head": lambda table: table.head(20),
    "twice": lambda table: pd.concat([table, table]),
}


@pytest.mark.parametrize("change", CHANGES)
def test_changed_rows_are_refused(dataset: StepDataset, change: str) -> None:
    with pytest.raises(InputError, match=r"picked or sorted(.|\n)*dataset\.select\(mask\)"):
        sampler(CHANGES[change](dataset.table))


def test_rows_that_pandas_does_not_follow(dataset: StepDataset) -> None:
    """A mapping carries no mark: its number of rows tells."""
    mask = dataset.table.task == "grasp"
    few = {name: dataset.table[name][mask].to_numpy() for name in BY}
    with pytest.raises(InputError, match=r"another table \(\d+ rows\)(.|\n)*dataset\.select\(mask\)"):
        next(iter(DataLoader(dataset, batch_sampler=sampler(few))))
    part = dataset.select(mask.to_numpy())
    assert all(
        set(part.table.task[batch.index.tolist()]) == {"grasp"}
        for batch in DataLoader(part, batch_sampler=sampler(part))
    )


def test_positions_of_another_dataset(release: rema_data.Release, dataset: StepDataset) -> None:
    others = [
        release.steps(split="train", which="all"),
        release.steps(tasks=["grasp", "grasp_push"], split="val", which="all"),
        dataset.select(np.arange(len(dataset))[::-1]),  # as many rows, in another order
    ]
    for other in others:
        with pytest.raises(InputError, match="another table"):
            next(iter(DataLoader(dataset, batch_sampler=sampler(other))))
        with pytest.raises(InputError, match="another table"):
            dataset.resident("cpu")[next(iter(sampler(other)))]
        with pytest.raises(InputError, match="another table"):
            dataset.select(next(iter(sampler(other))))
    again = release.steps(tasks=["grasp_push", "grasp"], split="train", which="all", maps="float32")
    assert len(dataset[next(iter(sampler(again)))]) == 4  # the same steps


def test_a_subset_is_served_with_global_positions(dataset: StepDataset) -> None:
    chosen = np.flatnonzero(dataset.table.task == "grasp")[::-1].tolist()
    for subset in (Subset(dataset, chosen), Subset(Subset(dataset, chosen[:10] + chosen), range(10, 10 + len(chosen)))):
        seen = set()
        for batch in DataLoader(subset, batch_sampler=sampler(subset)):
            assert sorted(batch.success.tolist()) == [False, False, True, True]
            assert batch.success.tolist() == dataset.table.success.iloc[batch.index.tolist()].tolist()
            seen |= set(batch.index.tolist())
        assert seen <= set(chosen) and len(seen) > len(chosen) / 2
    with pytest.raises(InputError, match="another table"):
        next(iter(DataLoader(dataset, batch_sampler=sampler(Subset(dataset, chosen)))))
    part = dataset.select(chosen)
    assert steps_of(part.table, range(len(part))) == steps_of(dataset.table, chosen)


def test_joined_datasets_are_refused_by_name(release: rema_data.Release, dataset: StepDataset) -> None:
    with pytest.raises(InputError, match=r"ConcatDataset(.|\n)*release\.steps"):
        sampler(ConcatDataset([dataset, release.steps()]))
    with pytest.raises(InputError, match=r"cannot be added(.|\n)*release\.steps"):
        dataset + release.steps()


def test_flat_positions_are_no_batches(dataset: StepDataset) -> None:
    """The mistake of handing single positions over as ``batch_sampler=``, which made batches of one."""
    flat = [position for batch in sampler(dataset) for position in batch]
    for positions in (flat, np.array(flat), map(np.int64, flat)):
        for read in (dataset, dataset.resident("cpu")):
            with pytest.raises(InputError, match=r"single(.|\n)*sampler=(.|\n)*batch_size="):
                next(iter(DataLoader(read, batch_sampler=positions)))  # type: ignore[arg-type]
    (batch, *_) = DataLoader(dataset, sampler=flat, batch_size=4)
    assert batch.index.tolist() == flat[:4]


def test_positions_are_lists_that_pickle() -> None:
    rows = Positions([3, 1], "of this", 9)
    again = pickle.loads(pickle.dumps(rows))
    assert again == [3, 1] and (again.source, again.rows) == ("of this", 9)
    joined: list[int] = []
    joined += rows  # as accelerate joins them
    assert joined == [3, 1] and rows[:1] == [3] and [*rows, 2] == [3, 1, 2]
