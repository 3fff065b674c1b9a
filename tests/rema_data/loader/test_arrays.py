"""Steps as numpy arrays: the bytes and the order of torch's loader, without torch, and resumable."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from torch.utils.data import DataLoader

import rema_data
from rema_data.errors import InputError
from rema_data.loader.dataset import Delivery, StepDataset

DELIVERIES = ("quantised", "float32")


def same(arrays: Any, batch: Any) -> bool:
    """Whether arrays are the tensors of a batch, byte for byte."""
    pairs = zip(arrays, batch.tensors, strict=True)
    return arrays._fields == batch.__match_args__ and all(
        (a.dtype, a.shape, a.tobytes()) == (b.numpy().dtype, tuple(b.shape), b.numpy().tobytes()) for a, b in pairs
    )


@pytest.fixture(scope="module", params=DELIVERIES)
def dataset(release: rema_data.Release, request: pytest.FixtureRequest) -> StepDataset:
    return release.steps(split="train", which="all", maps=request.param)


def sampler_of(dataset: StepDataset, **options: Any) -> rema_data.BalancedSampler:
    return rema_data.BalancedSampler(dataset, batch_size=12, by=("task", "success"), seed=4, **options)


def test_an_epoch_is_that_of_the_torch_loader(dataset: StepDataset) -> None:
    arrays, sampler = dataset.numpy_batches(sampler_of(dataset)), sampler_of(dataset)
    compared = [same(a, b) for a, b in zip(arrays, DataLoader(dataset, batch_sampler=sampler), strict=True)]
    assert all(compared) and len(compared) == len(sampler) > 3


def test_every_rank_gets_its_part(dataset: StepDataset) -> None:
    for rank in range(2):
        options = {"rank": rank, "world_size": 2}
        loader = DataLoader(dataset, batch_sampler=sampler_of(dataset, **options))
        arrays = dataset.numpy_batches(sampler_of(dataset, **options))
        assert all(same(a, b) for a, b in zip(arrays, loader, strict=True))


@given(data=st.data())
def test_a_stopped_epoch_continues_with_the_next_batch(release: rema_data.Release, data: st.DataObject) -> None:
    dataset = release.steps(split="train", which="all")
    sampler = sampler_of(dataset)
    whole = [batch.index.tolist() for _ in range(2) for batch in dataset.numpy_batches(sampler)]
    taken = data.draw(st.integers(1, len(whole) - 1))
    first = sampler_of(dataset)
    batches = (batch for _ in range(2) for batch in dataset.numpy_batches(first))
    head = [next(batches).index.tolist() for _ in range(taken)]
    resumed = sampler_of(dataset)
    resumed.load_state_dict(first.state_dict())
    rest = []
    while len(head) + len(rest) < len(whole):
        rest += [batch.index.tolist() for batch in dataset.numpy_batches(resumed)]
    assert head + rest == whole


def test_a_state_goes_to_the_torch_loader_and_back(dataset: StepDataset) -> None:
    sampler, other = sampler_of(dataset), sampler_of(dataset)
    batches = dataset.numpy_batches(sampler)
    next(batches)
    other.load_state_dict(sampler.state_dict())
    assert same(next(batches), next(iter(DataLoader(dataset, batch_sampler=other))))


def test_indexing_is_that_of_numpy(dataset: StepDataset) -> None:
    arrays = dataset.arrays
    assert len(arrays) == len(dataset)
    for which in (slice(2, 9, 3), [4, 4, 1], np.array([-1, 0]), []):
        assert same(arrays[which], dataset.__getitems__(dataset.positions(which)))
    for one in (3, -1, np.int64(3)):
        batch = dataset[one]  # type: ignore[index]
        step = arrays[one]  # type: ignore[index]
        assert all(np.array_equal(a, b[0].numpy()) for a, b in zip(step, batch.tensors, strict=True))
    assert arrays[3].scene.shape == dataset[3].scene.shape[1:]


def test_metres_are_those_of_the_float_delivery(release: rema_data.Release) -> None:
    quantised, metres = release.steps().arrays[:], release.steps(maps="float32").arrays[:]
    assert all(a.tobytes() == b.tobytes() for a, b in zip(quantised.float(), metres, strict=True))
    assert metres.float() is metres


def test_a_single_step_in_metres_is_that_of_many(release: rema_data.Release) -> None:
    arrays = release.steps(which="all").arrays
    one, many = arrays[3].float(), arrays[:5].float()
    assert all(np.array_equal(a, b[3]) for a, b in zip(one, many, strict=True))


def test_arrays_are_copies_that_may_be_changed(dataset: StepDataset) -> None:
    batch = dataset.arrays[:2]
    before = batch.scene.copy()
    batch.scene[:] = 1
    assert np.array_equal(dataset.arrays[:2].scene, before)


def test_pickled_arrays_are_the_same(dataset: StepDataset) -> None:
    arrays = dataset.arrays
    again = pickle.loads(pickle.dumps(arrays))
    assert all(np.array_equal(a, b) for a, b in zip(again[:], arrays[:], strict=True))


def test_positions_are_checked_as_for_torch(release: rema_data.Release, dataset: StepDataset) -> None:
    with pytest.raises(IndexError, match=f"{len(dataset)} steps"):
        dataset.arrays[len(dataset)]
    with pytest.raises(InputError, match="count in another table"):
        next(dataset.numpy_batches(sampler_of(release.steps(split="train"))))
    with pytest.raises(InputError, match="a batch of positions is expected"):
        next(dataset.numpy_batches([3]))  # type: ignore[list-item]


WITHOUT_TORCH = """
import sys
import rema_data

release = rema_data.Release(rema_data.load(sys.argv[1]).folder, cache=sys.argv[2])
dataset = release.steps(split="train", which="all", maps=sys.argv[3])
assert dataset.arrays[0].success in (True, False)
sampler = rema_data.BalancedSampler(dataset, batch_size=12, by=("task", "success"), seed=0)
batches = dataset.numpy_batches(sampler)
next(batches)
resumed = rema_data.BalancedSampler(dataset, batch_size=12, by=("task", "success"), seed=0)
resumed.load_state_dict(sampler.state_dict())
assert next(batches).index.tolist() == next(dataset.numpy_batches(resumed)).index.tolist()
part = dataset.select(dataset.table["success"].to_numpy())
assert part.arrays[:].success.all()
release.episode(1, "grasp", "train", 0)
loaded = sorted(name for name in sys.modules if name.partition(".")[0] == "torch")
sys.exit(f"loaded {loaded[:3]}" if loaded else 0)
"""


@pytest.mark.parametrize("maps", DELIVERIES)
def test_reading_needs_no_torch(release: rema_data.Release, tmp_path: Path, maps: Delivery) -> None:
    words = [str(release.folder.path), str(tmp_path), maps]
    done = subprocess.run([sys.executable, "-c", WITHOUT_TORCH, *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
