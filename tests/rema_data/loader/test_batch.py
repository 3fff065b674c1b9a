"""Batches move and convert without touching their labels, and are indexed by whatever names steps."""

from __future__ import annotations

import copy
import dataclasses
from typing import Any

import numpy as np
import pytest
import torch

import rema_data
from rema_data.errors import InputError
from rema_data.loader.batch import FloatBatch, StepBatch
from tests.rema_data.loader.test_dataset import equal

LABELS = ("action", "success", "index")


@pytest.fixture
def floats(release: rema_data.Release) -> FloatBatch:
    batch = release.steps(maps="float32")[:6]
    assert isinstance(batch, FloatBatch)
    return batch.replace(action=torch.full((6,), 4825), index=torch.arange(70_001, 70_007))


def unlike(batch: FloatBatch, other: FloatBatch) -> list[str]:
    """Fields that differ in type or value."""
    return [
        field.name
        for field in dataclasses.fields(batch)
        if (a := getattr(batch, field.name)).dtype != (b := getattr(other, field.name)).dtype or not torch.equal(a, b)
    ]


@pytest.mark.parametrize("kind", [torch.float16, torch.bfloat16, torch.float64])
def test_only_maps_follow_a_type(floats: FloatBatch, kind: torch.dtype) -> None:
    for moved in (
        floats.to(kind),
        floats.to("cpu", kind),
        floats.to(device="cpu", dtype=kind),
        floats.to(device=torch.device("cpu"), dtype=kind, non_blocking=True),
    ):
        assert unlike(moved, floats) == ["scene", "end_effector"] and moved.scene.dtype == kind
        assert torch.equal(moved.end_effector, floats.end_effector.to(kind))
        assert moved.action.tolist() == [4825] * 6 and moved.index.tolist() == list(range(70_001, 70_007))
    assert equal(floats.to(kind).to(torch.float64).to("cpu").to(kind), floats.to(kind))


def test_every_field_moves(floats: FloatBatch, release: rema_data.Release) -> None:
    for batch in (floats, release.steps()[:3]):
        for moved in (batch.to("meta"), batch.to("meta", torch.bfloat16), batch.to(device=torch.device("meta"))):
            assert {tensor.device.type for tensor in moved.tensors} == {"meta"}
            assert type(moved) is type(batch)


def test_a_quantised_batch_has_nothing_to_convert(release: rema_data.Release) -> None:
    batch = release.steps()[:3]
    assert equal(batch.to(torch.bfloat16), batch)
    assert batch.float().to(torch.bfloat16).scene.dtype == torch.bfloat16


@pytest.mark.parametrize("kind", [torch.int64, torch.bool, "float16", True])
def test_types_that_are_not_floating_are_refused(floats: FloatBatch, kind: Any) -> None:
    with pytest.raises(InputError, match="cannot be converted"):
        floats.to("cpu", kind)


def lightning_converts(batch: Any, kind: torch.dtype) -> Any:
    """What ``precision="bf16-true"`` does to a dataclass: set the converted fields of a copy, whose memo has them."""
    values = {field.name: getattr(batch, field.name) for field in dataclasses.fields(batch)}
    result = copy.deepcopy(batch, memo={id(value): value for value in values.values()})
    for name, value in values.items():
        setattr(result, name, value.to(kind) if torch.is_floating_point(value) else value)
    return result


def test_lightning_in_true_half_precision(floats: FloatBatch, release: rema_data.Release) -> None:
    before = copy.deepcopy(floats)
    batch = lightning_converts(floats.to(torch.device("cpu"), non_blocking=True), torch.bfloat16)
    assert equal(batch, floats.to(torch.bfloat16)) and equal(floats, before)
    layer = torch.nn.Conv2d(1, 1, 3, dtype=torch.bfloat16)
    assert layer(batch.scene).dtype == torch.bfloat16
    quantised = lightning_converts(release.steps()[:6], torch.bfloat16)
    assert isinstance(quantised, StepBatch)
    assert torch.equal(quantised.float().to(torch.bfloat16).scene, release.steps(maps="float32")[:6].scene.bfloat16())


@pytest.mark.parametrize("form", [int, np.int64, np.uint8, np.array, torch.tensor])
@pytest.mark.parametrize("step", [0, 2, 5])
def test_one_step_in_any_form(floats: FloatBatch, form: Any, step: int) -> None:
    assert equal(floats[form(step)], floats[step : step + 1])


@pytest.mark.parametrize("form", [list, np.array, torch.tensor, lambda steps: np.array(steps, np.uint8), range])
def test_several_steps_in_any_form(floats: FloatBatch, form: Any) -> None:
    steps = [1, 2, 3] if form is range else [4, 0, 0, 5]
    chosen = floats[range(1, 4)] if form is range else floats[form(steps)]
    assert chosen.index.tolist() == [70_001 + step for step in steps]


def test_masks_and_nothing(floats: FloatBatch) -> None:
    mask = [True, False, True, False, False, True]
    for form in (list(mask), np.array(mask), torch.tensor(mask)):
        assert floats[form].index.tolist() == [70_001, 70_003, 70_006]
    assert len(floats[[]]) == len(floats[np.zeros(0, np.int64)]) == 0


@pytest.mark.parametrize(
    "which", [True, np.bool_(True), None, 0.0, (0, 1), (slice(None), 0), [[0, 1]], "0", [0.5], ...]
)
def test_what_names_no_steps(floats: FloatBatch, which: Any) -> None:
    with pytest.raises(InputError, match="names no steps"):
        floats[which]


@pytest.mark.parametrize("which", [6, -7, np.int64(6), [0, 6], np.array([9])])
def test_steps_outside(floats: FloatBatch, which: Any) -> None:
    with pytest.raises(IndexError):
        floats[which]
