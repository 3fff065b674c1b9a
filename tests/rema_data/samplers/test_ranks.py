"""Several processes never share their batches by mistake: the sampler refuses what it cannot know."""

from __future__ import annotations

import re
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

import rema_data
from rema_data.errors import InputError
from rema_data.samplers import BalancedSampler
from tests.rema_data.loader.test_batch import lightning_converts
from tests.rema_data.samplers.tables import uneven

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "dataset.md").read_text(encoding="utf-8")
SECTION = re.split(r"\n##+ ", PAGE.split("### Several processes")[1])[0]
BLOCKS = re.findall(r"```python\n(.*?)```", SECTION, re.DOTALL)
TORCHRUN, LIGHTNING, ACCELERATE = BLOCKS


def made(**options: Any) -> BalancedSampler:
    return BalancedSampler(uneven(), 4, by="success", num_samples=44, **options)


def join(monkeypatch: pytest.MonkeyPatch, rank: int, world_size: int) -> None:
    """Let torch.distributed say that this process is one of several."""
    for name, value in {"is_initialized": True, "get_rank": rank, "get_world_size": world_size}.items():
        monkeypatch.setattr(torch.distributed, name, lambda value=value: value)


@pytest.mark.parametrize("size", ["2", "16"])
def test_a_process_that_has_not_joined_is_refused(monkeypatch: pytest.MonkeyPatch, size: str) -> None:
    monkeypatch.setenv("WORLD_SIZE", size)
    with pytest.raises(InputError, match=rf"WORLD_SIZE is {size}(.|\n)*init_process_group(.|\n)*rank="):
        made()
    assert made(rank=0, world_size=1).world_size == 1 and made(rank=1, world_size=2).rank == 1
    join(monkeypatch, 1, 2)
    assert (made().rank, made().world_size) == (1, 2)


@pytest.mark.parametrize("size", ["1", "", "many"])
def test_one_process_alone(monkeypatch: pytest.MonkeyPatch, size: str) -> None:
    monkeypatch.setenv("WORLD_SIZE", size)
    assert made().world_size == 1


@pytest.mark.parametrize("rank", [0, 1])
def test_a_sampler_that_is_older_than_the_group_is_refused(monkeypatch: pytest.MonkeyPatch, rank: int) -> None:
    early, told = made(), made(rank=rank, world_size=2)
    join(monkeypatch, rank, 2)
    with pytest.raises(InputError, match=rf"made for rank 0 of 1, and this is rank {rank} of 2(.|\n)*train_dataloader"):
        next(iter(early))
    assert next(iter(told)) == next(iter(made()))


def accelerate_deals_out(batches: Any, processes: int, process: int) -> Iterator[Any]:
    """What ``accelerator.prepare`` does to a sampler of batches by default."""
    first: list[int] = []
    kept: Any = []
    for number, batch in enumerate(batches):
        if not getattr(batches, "drop_last", False) and number < processes:
            first += batch
        if number % processes == process:
            kept = batch
        if number % processes == processes - 1 and len(batch) == batches.batch_size:
            yield kept
            kept = []
    if not getattr(batches, "drop_last", False) and kept:
        yield kept


def test_accelerate_with_two_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    join(monkeypatch, 0, 2)
    state = types.SimpleNamespace(is_initialized=lambda: True)
    monkeypatch.setitem(sys.modules, "accelerate.state", state)
    with pytest.raises(InputError, match=r"accelerate(.|\n)*rank=0, world_size=1(.|\n)*process_index"):
        made()
    whole = made(rank=0, world_size=1)
    expected = [list(batch) for batch in made(rank=0, world_size=1)]
    parts = [list(accelerate_deals_out(whole, 2, 0))]
    whole.set_epoch(0)
    parts.append(list(accelerate_deals_out(whole, 2, 1)))
    assert [batch for pair in zip(*parts, strict=True) for batch in pair] == expected[:10]
    assert all(sum(uneven()["success"][batch]) == 2 for part in parts for batch in part)
    state.is_initialized = lambda: False  # imported, and not in use
    assert made().world_size == 2


def test_the_recipe_for_accelerate(monkeypatch: pytest.MonkeyPatch) -> None:
    join(monkeypatch, 1, 2)
    monkeypatch.setitem(sys.modules, "accelerate.state", types.SimpleNamespace(is_initialized=lambda: True))

    class Accelerator:
        def prepare(self, model: Any, optimiser: Any, loader: Any) -> Any:
            dealt = accelerate_deals_out(loader.batch_sampler, 2, 1)
            return model, optimiser, torch.utils.data.DataLoader(loader.dataset, batch_sampler=list(dealt))

    names = {"accelerate": types.SimpleNamespace(Accelerator=Accelerator), "rema_data": rema_data, "torch": torch}
    exec(ACCELERATE, names | {"model": None, "optimiser": None}, found := {})
    batches = list(found["loader"])
    assert len(batches) == len(found["sampler"]) // 2
    assert all(batch.success.tolist().count(True) == 2 for batch in batches)


def test_the_recipe_for_lightning(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both ranks in turn; Lightning makes the group first, then asks for the loader, and converts every batch."""
    monkeypatch.setenv("WORLD_SIZE", "2")
    seen: list[list[list[int]]] = []

    class Trainer:
        def __init__(self, **options: Any) -> None:
            assert options["use_distributed_sampler"] is False

        def fit(self, model: Any, data: Any) -> None:
            for rank in range(2):
                join(monkeypatch, rank, 2)
                batches = [lightning_converts(batch, torch.bfloat16) for batch in data.train_dataloader()]
                assert all(batch.scene.dtype == torch.bfloat16 and sum(batch.success) == 2 for batch in batches)
                seen.append([batch.index.tolist() for batch in batches])

    names = {"lightning": types.SimpleNamespace(LightningDataModule=object, Trainer=Trainer), "model": None}
    exec(LIGHTNING, names | {"rema_data": rema_data, "torch": torch})
    dataset = rema_data.load("rema-sample").steps(tasks=["grasp"], split="train")
    alone = BalancedSampler(dataset, 8, by=("success",), seed=0, rank=0, world_size=1)
    assert [sorted(a + b) for a, b in zip(*seen, strict=True)] == [sorted(batch) for batch in alone]
