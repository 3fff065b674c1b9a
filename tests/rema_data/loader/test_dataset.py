"""Batches hold what was observed, in the order that was asked for, whatever way they are asked for."""

from __future__ import annotations

import copy
import io
import pickle
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.utils.data import DataLoader, Subset

import rema_data
from rema_data.errors import InputError
from rema_data.heights import unpack_mask
from rema_data.loader.batch import FloatBatch, StepBatch
from rema_data.loader.dataset import Delivery, StepDataset
from rema_data.schema import Step


def equal(a: StepBatch | FloatBatch, b: StepBatch | FloatBatch) -> bool:
    """Same kind, types, shapes and bits."""
    pairs = zip(a.tensors, b.tensors, strict=True)
    return type(a) is type(b) and all(x.dtype == y.dtype and torch.equal(x, y) for x, y in pairs)


@pytest.fixture(scope="module")
def dataset(release: rema_data.Release) -> StepDataset:
    return release.steps(split="train", which="all")


@pytest.fixture(scope="module")
def steps(release: rema_data.Release, dataset: StepDataset) -> list[Step]:
    """The step of every row, by way of the episodes."""
    rows = dataset.table[["round", "task", "split", "episode", "step"]].astype(object).values.tolist()
    return [release.episode(*row[:4]).steps[row[4]] for row in rows]


def test_quantised_batch_is_what_was_observed(dataset: StepDataset, steps: list[Step]) -> None:
    batch = dataset[:]
    assert isinstance(batch, StepBatch) and len(batch) == len(dataset) == len(steps)
    for at, step in enumerate(steps):
        assert np.array_equal(batch.scene[at].numpy(), step.observation.scene)
        assert np.array_equal(batch.ee_depth[at].numpy(), step.observation.depth)
        assert np.array_equal(unpack_mask(batch.ee_mask[at].numpy()), step.observation.mask)
    assert batch.action.tolist() == [step.action.index for step in steps]
    assert batch.success.tolist() == [step.outcome.success for step in steps] == dataset.table.success.tolist()
    assert batch.index.tolist() == list(range(len(steps)))


def test_types_and_shapes(dataset: StepDataset) -> None:
    shapes = {"scene": (3, 64, 64), "ee_depth": (3, 2, 112, 112), "ee_mask": (3, 2, 112, 14)}
    kinds = {"scene": torch.int16, "ee_depth": torch.int16, "ee_mask": torch.uint8, "success": torch.bool}
    batch = dataset[[4, 4, 1]]
    for name in ("scene", "ee_depth", "ee_mask", "action", "success", "index"):
        tensor = getattr(batch, name)
        assert tensor.shape == shapes.get(name, (3,)) and tensor.dtype == kinds.get(name, torch.int64)
        assert tensor.is_contiguous()


def test_float_batch_is_what_a_policy_sees_bit_for_bit(release: rema_data.Release, steps: list[Step]) -> None:
    batch = release.steps(split="train", which="all", maps="float32")[:]
    assert isinstance(batch, FloatBatch)
    for at, step in enumerate(steps):
        seen = step.observation
        assert batch.scene[at, 0].numpy().tobytes() == seen.scene_m().tobytes()
        planes = np.ascontiguousarray(np.moveaxis(seen.end_effector(), -1, 0))
        assert batch.end_effector[at].numpy().tobytes() == planes.tobytes()


def test_one_step_is_a_batch_of_one(dataset: StepDataset) -> None:
    assert equal(dataset[5], dataset.__getitems__([5])) and len(dataset[5]) == 1
    assert equal(dataset[-1], dataset[len(dataset) - 1])


@pytest.fixture(scope="module")
def whole(dataset: StepDataset) -> StepBatch | FloatBatch:
    return dataset[:]


@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_any_positions_in_any_form(dataset: StepDataset, whole: StepBatch | FloatBatch, data: st.DataObject) -> None:
    count = len(dataset)
    wanted = data.draw(st.lists(st.integers(-count, count - 1), max_size=20))
    batch = dataset.__getitems__(wanted)
    assert equal(batch, whole[torch.tensor(wanted, dtype=torch.int64)])
    for form in (np.array(wanted, np.int64), np.array(wanted, np.int32), torch.tensor(wanted, dtype=torch.int64)):
        assert equal(dataset.__getitems__(form), batch)


def test_batch_is_not_a_view_of_the_request(dataset: StepDataset) -> None:
    request = np.array([1, 2, 3])
    batch = dataset.__getitems__(request)
    request[:] = 0
    assert batch.index.tolist() == [1, 2, 3]
    before = dataset[1]
    batch.scene.zero_()
    assert equal(dataset[1], before)


@pytest.mark.parametrize("which", [10_000, -10_000, [0, 10_000]])
def test_positions_outside(dataset: StepDataset, which: Any) -> None:
    with pytest.raises(IndexError, match=f"{len(dataset)} steps"):
        dataset[which]


@pytest.mark.parametrize("which", [0.5, [True, False], np.zeros(3, bool)])
def test_positions_that_are_no_whole_numbers(dataset: StepDataset, which: Any) -> None:
    with pytest.raises(InputError, match="whole numbers"):
        dataset[which]


def test_iteration_ends(dataset: StepDataset) -> None:
    """Python iterates over whatever has ``__getitem__``, until an IndexError."""
    assert sum(len(batch) for batch in dataset) == len(dataset)  # type: ignore[attr-defined]


def test_fingerprint_is_of_release_and_selection(release: rema_data.Release) -> None:
    options: list[dict[str, Any]] = [
        {},
        {"tasks": ["grasp"]},
        {"split": "val"},
        {"rounds": [1]},
        {"which": "all"},
        {"which": "picks"},
        {"skills": ["grasp"]},
    ]
    prints = [release.steps(**option).fingerprint for option in options]
    assert len(set(prints)) == len(options)
    assert (
        release.steps(tasks=["grasp", "grasp_push"]).fingerprint
        == release.steps(tasks=("grasp_push", "grasp"), maps="float32").fingerprint
    )
    assert [release.steps(**option).fingerprint for option in options] == prints


def test_select(dataset: StepDataset) -> None:
    mask = (dataset.table.task == "grasp").to_numpy()
    part = dataset.select(mask)
    assert len(part) == mask.sum() and set(part.table.task) == {"grasp"}
    assert torch.equal(part[:].scene, dataset[np.flatnonzero(mask)].scene)
    assert part.fingerprint == dataset.select(np.flatnonzero(mask)).fingerprint != dataset.fingerprint
    assert list(part.select([2, 0]).table.episode) == list(part.table.episode.iloc[[2, 0]])
    with pytest.raises(InputError, match="a mask of shape"):
        dataset.select(mask[1:])


def test_pickled_dataset_is_small_and_the_same(dataset: StepDataset) -> None:
    assert len(dataset.table) == len(dataset[:])  # both are open now
    data = pickle.dumps(dataset)
    again = pickle.loads(data)
    assert len(data) < 100 * len(dataset) + 10_000
    assert equal(again[:], dataset[:]) and again.table.equals(dataset.table)
    assert again.fingerprint == dataset.fingerprint


def test_memory_dataset_survives_pickling(release: rema_data.Release, dataset: StepDataset) -> None:
    memory = rema_data.Release(release.folder, cache="memory").steps(split="train", which="all")
    assert equal(memory[:], dataset[:]) and memory.fingerprint == dataset.fingerprint
    assert equal(pickle.loads(pickle.dumps(memory))[:], dataset[:])


ORDER = [[3, 1, 4], [1, 5], [9], [2, 6, 5, 3]]


@pytest.mark.parametrize("maps", ["quantised", "float32"])
def test_data_loaders_keep_batches_whole(release: rema_data.Release, maps: Delivery) -> None:
    dataset = release.steps(maps=maps)
    wanted = [dataset.__getitems__(order) for order in ORDER]
    flat = [position for order in ORDER for position in order]
    arrays = [np.array(order) for order in ORDER]
    for loader in (
        DataLoader(dataset, batch_sampler=ORDER),
        DataLoader(dataset, batch_sampler=arrays),  # type: ignore[arg-type]
        DataLoader(dataset, batch_size=None, sampler=arrays),  # type: ignore[arg-type]
    ):
        assert all(equal(a, b) for a, b in zip(loader, wanted, strict=True))
    pairs = zip(DataLoader(dataset, batch_size=4, sampler=flat), (flat[:4], flat[4:8], flat[8:]), strict=True)
    assert all(equal(batch, dataset.__getitems__(part)) for batch, part in pairs)


def test_subset_and_single_items_are_joined(dataset: StepDataset) -> None:
    class OneByOne(torch.utils.data.Dataset[Any]):
        def __getitem__(self, index: int) -> Any:
            return dataset[index]

        def __len__(self) -> int:
            return len(dataset)

    (batch,) = DataLoader(OneByOne(), batch_sampler=[[3, 1, 4]])
    assert equal(batch, dataset[[3, 1, 4]])
    (batch,) = DataLoader(Subset(dataset, [7, 8, 9]), batch_size=3)
    assert equal(batch, dataset[[7, 8, 9]])


@pytest.mark.filterwarnings("ignore:You are using .torch.load. with:FutureWarning")  # torch 2.4 unpickles tensors so
@pytest.mark.parametrize("maps", ["quantised", "float32"])
def test_batch_laws(release: rema_data.Release, maps: Delivery) -> None:
    batch = release.steps(maps=maps)[:6]
    assert equal(batch[1:3], batch[torch.tensor([1, 2])]) and equal(batch[-1], batch[5:])
    assert equal(batch.to("cpu"), batch)
    assert [len(one) for one in batch] == [1] * 6
    with pytest.raises(IndexError):
        batch[6]
    assert equal(copy.deepcopy(batch), batch) and equal(pickle.loads(pickle.dumps(batch)), batch)
    other = batch.replace(scene=batch.scene + 1)
    assert torch.equal(other.scene, batch.scene + 1) and equal(other.replace(scene=batch.scene), batch)
    with pytest.raises(AttributeError):
        batch.label = batch.scene  # type: ignore[union-attr]


def test_quantised_batches_convert_to_the_same_floats(release: rema_data.Release) -> None:
    """On the processor, by the kernels of a device, and by the dataset itself; also from part of a batch."""
    from rema_data.loader import convert

    quantised, floats = release.steps()[:], release.steps(maps="float32")[:]
    assert isinstance(quantised, StepBatch) and equal(quantised.float(), floats)
    assert equal(quantised[::3].float(), floats[::3]) and floats.float() is floats
    scene, planes = convert.to_metres_on_device(quantised.scene, quantised.ee_depth, quantised.ee_mask)
    assert torch.equal(scene, floats.scene) and torch.equal(planes, floats.tensors[1])
    assert len(quantised[:0].float()) == 0


def test_saved_batch_stands_alone(dataset: StepDataset) -> None:
    file = io.BytesIO()
    torch.save(dataset[:3], file)
    file.seek(0)
    assert equal(torch.load(file, weights_only=False), dataset[:3])


def test_batches_of_batches_are_refused(dataset: StepDataset) -> None:
    """The mistake of handing a sampler of batches over as ``sampler=``."""
    sampler = rema_data.BalancedSampler(dataset, batch_size=2, by=("success",))
    with pytest.raises(InputError, match="not one batch"):
        next(iter(DataLoader(dataset, sampler=sampler, batch_size=8)))
