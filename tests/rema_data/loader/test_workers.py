"""Batches that worker processes gather are the ones of this process, however the workers are started."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader
from torchdata.stateful_dataloader import StatefulDataLoader

import rema_data
from rema_data.loader.batch import StepBatch
from rema_data.loader.dataset import Delivery
from tests.rema_data.loader.test_dataset import equal

ORDER = np.random.default_rng(0).integers(0, 40, (12, 3)).tolist()


@pytest.mark.filterwarnings("ignore:This DataLoader will create")
@pytest.mark.parametrize(
    ("context", "workers", "maps"),
    [
        (None, 0, "quantised"),
        (None, 0, "float32"),
        ("fork", 2, "quantised"),
        ("fork", 2, "float32"),
        ("fork", 4, "quantised"),
        ("spawn", 2, "float32"),
        pytest.param("spawn", 2, "quantised", marks=pytest.mark.slow),
        pytest.param("spawn", 4, "quantised", marks=pytest.mark.slow),
    ],
)
def test_same_batches(release: rema_data.Release, context: str | None, workers: int, maps: Delivery) -> None:
    dataset = release.steps(maps=maps)
    dataset[0]  # maps are open, and torch has threads, when the workers are forked
    wanted = [dataset.__getitems__(order) for order in ORDER]
    loader = DataLoader(dataset, batch_sampler=ORDER, num_workers=workers, multiprocessing_context=context)
    assert all(equal(a, b) for a, b in zip(loader, wanted, strict=True))


def test_balanced_batches_as_the_readme_types_them(release: rema_data.Release) -> None:
    dataset = release.steps(split="train")
    sampler = rema_data.BalancedSampler(dataset, batch_size=12, by=("task", "success"), seed=0)
    for batch in DataLoader(dataset, batch_sampler=sampler, num_workers=2):
        table = dataset.table.iloc[batch.index.numpy()]
        assert table.groupby(["task", "success"], observed=True).size().tolist() == [2] * 6
        assert batch.success.tolist() == table.success.tolist()


def test_memory_cache_in_forked_workers(release: rema_data.Release) -> None:
    dataset = rema_data.Release(release.folder, cache="memory").steps()
    loader = DataLoader(dataset, batch_sampler=ORDER, num_workers=2, multiprocessing_context="fork")
    assert all(equal(a, dataset.__getitems__(order)) for a, order in zip(loader, ORDER, strict=True))


def changed(batch: StepBatch) -> StepBatch:
    """A collate function that works on the batch in the worker."""
    batch.scene.add_(1)
    return batch


def test_what_a_worker_does_to_a_batch_arrives(release: rema_data.Release) -> None:
    dataset: Any = release.steps()
    for batch, order in zip(
        DataLoader(dataset, batch_sampler=ORDER, num_workers=2, collate_fn=changed), ORDER, strict=True
    ):
        assert torch.equal(batch.scene, dataset.__getitems__(order).scene + 1)


def test_batches_from_workers_can_be_kept_and_written_to(release: rema_data.Release) -> None:
    dataset = release.steps()
    kept = list(DataLoader(dataset, batch_sampler=ORDER, num_workers=2))
    kept[0].scene.zero_()
    assert all(equal(a, dataset.__getitems__(order)) for a, order in zip(kept[1:], ORDER[1:], strict=True))


@pytest.mark.filterwarnings("ignore:'set_vital' is deprecated")
@pytest.mark.parametrize("workers", [0, 2])
def test_stateful_loader_resumes(release: rema_data.Release, workers: int) -> None:
    dataset = release.steps()
    loader = StatefulDataLoader(dataset, batch_sampler=ORDER, num_workers=workers)
    head = []
    for batch in loader:
        head.append(batch)
        if len(head) == 5:
            state = loader.state_dict()
            break
    resumed = StatefulDataLoader(dataset, batch_sampler=ORDER, num_workers=workers)
    resumed.load_state_dict(state)
    batches = head + list(resumed)
    assert all(equal(a, dataset.__getitems__(order)) for a, order in zip(batches, ORDER, strict=True))
