"""Batches from the memory of a device are the ones of the dataset."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

import rema_data
from rema_data.errors import InputError
from rema_data.loader.dataset import Delivery
from tests.rema_data.loader.test_dataset import equal

DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU"))]


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("maps", ["quantised", "float32"])
def test_same_interface_and_batches(release: rema_data.Release, maps: Delivery, device: str) -> None:
    dataset = release.steps(["grasp_push"], which="all", maps=maps)
    resident = dataset.resident(device)
    assert len(resident) == len(dataset) and resident.fingerprint == dataset.fingerprint
    assert resident.table.equals(dataset.table) and resident.delivery == maps
    order = np.random.default_rng(0).integers(-len(dataset), len(dataset), 50)
    for which in (order, order.tolist(), torch.from_numpy(order), 3, slice(2, 9)):
        batch = resident[which]
        assert batch.scene.device.type == device and equal(batch.to("cpu"), dataset[which])
    parts = order.reshape(10, 5).tolist()
    for batch, part in zip(DataLoader(resident, batch_sampler=parts), parts, strict=True):
        assert equal(batch.to("cpu"), dataset.__getitems__(part))
    with pytest.raises(IndexError):
        resident[len(dataset)]


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_maps_that_do_not_fit(release: rema_data.Release, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda _: (1000, 2000))
    with pytest.raises(InputError, match="free on cuda"):
        release.steps().resident("cuda")


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("workers", [0, 2])
def test_pinned_batches(release: rema_data.Release, workers: int) -> None:
    dataset = release.steps()
    for batch in DataLoader(dataset, batch_sampler=[[1, 2], [3]], num_workers=workers, pin_memory=True):
        assert all(tensor.is_pinned() for tensor in batch.tensors)
        assert equal(batch.to("cuda", non_blocking=True).to("cpu"), dataset.__getitems__(batch.index))
