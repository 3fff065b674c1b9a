"""Statistics of maps and actions: those that numpy gives for all values of exactly the selected steps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import rema_data
from rema_data.grid import decode, to_world
from rema_data.statistics.values import ChannelValues, value_statistics
from rema_data.testing import make_release

MOST = 32667
"""The highest height that a release holds, in 0.1 mm."""


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> rema_data.Release:
    root = tmp_path_factory.mktemp("releases")
    folder = make_release(root, tasks=("grasp", "grasp_push"), rounds=(1, 2), episodes=8, success=0.6)
    return rema_data.Release(folder, cache=root / "decoded")


def check(found: ChannelValues, values: Any) -> None:
    """A channel against numpy's answer for all of its values, float64."""
    values = np.asarray(values, np.float64).ravel()
    low, high = np.quantile(values, [0.01, 0.99])
    assert (found.count, found.min, found.max) == (
        values.size,
        pytest.approx(values.min()),
        pytest.approx(values.max()),
    )
    for got, wanted in ((found.mean, values.mean()), (found.std, values.std()), (found.q01, low), (found.q99, high)):
        assert got == pytest.approx(wanted, rel=1e-9, abs=1e-12)


heights = st.integers(-100, MOST) | st.sampled_from([0, 300, 500])


@given(
    scene=hnp.arrays(np.int16, (3, 8, 8), elements=heights),
    depth=hnp.arrays(np.int16, (2, 2, 8, 8), elements=heights),
    mask=hnp.arrays(np.uint8, (2, 2, 8, 1)),
    scene_row=st.lists(st.integers(0, 2), min_size=5, max_size=5),
    ee_row=st.lists(st.integers(0, 1), min_size=5, max_size=5),
    action=st.lists(st.integers(0, 2**16 - 1), min_size=5, max_size=5),
)
def test_they_are_those_of_numpy(
    scene: Any, depth: Any, mask: Any, scene_row: list[int], ee_row: list[int], action: list[int]
) -> None:
    """A map that several steps have counts for each of them; one that no step has does not count."""
    rows = (np.array(scene_row), np.array(ee_row), np.array(ee_row))
    found = value_statistics("", (scene, rows[0]), (depth, rows[1]), (mask, rows[2]), np.array(action))
    check(found["scene"], scene[scene_row] * 1e-4)
    for state in (0, 1):
        check(found[f"depth_{state + 1}"], depth[ee_row][:, state] * 1e-4)
        check(found[f"mask_{state + 1}"], np.unpackbits(mask[ee_row][:, state], axis=-1))
    for name, values in zip("ijk", decode(np.array(action)), strict=True):
        check(found[name], values)
    for name, values in zip(("x_m", "y_m", "theta_rad"), to_world(np.array(action)), strict=True):
        check(found[name], values)


@pytest.mark.parametrize("options", [{}, {"tasks": ["grasp"], "split": "val"}, {"which": "picks"}])
def test_a_selection_of_a_release(release: rema_data.Release, options: dict[str, Any]) -> None:
    dataset = release.steps(**options, maps="float32")
    found, batch = dataset.statistics(), dataset.arrays[:].float()
    assert found.steps == len(dataset) and found.fingerprint == dataset.fingerprint
    names = ("depth_1", "mask_1", "depth_2", "mask_2")
    for name, values in (("scene", batch.scene), *((n, batch.end_effector[:, c]) for c, n in enumerate(names))):
        assert found[name].mean == pytest.approx(values.mean(dtype=np.float64), rel=1e-6)
        assert found[name].std == pytest.approx(values.std(dtype=np.float64), rel=1e-6)
    part = dataset.select([0])
    assert part.statistics()["k"].count == 1 and part.statistics() != found
    assert release.steps(**options).statistics() == found
    with pytest.raises(KeyError, match="none of scene, depth_1"):
        found["z"]


def test_they_are_counted_once(release: rema_data.Release, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = release.steps(split="train")
    found = dataset.statistics()
    assert release.cache.folder is not None
    (path,) = release.cache.folder.glob(f"values-{dataset.fingerprint}.json")
    with monkeypatch.context() as patch:
        patch.setattr("rema_data.statistics.values.value_statistics", None)
        assert release.steps(split="train").statistics() == found
    damaged = json.loads(path.read_text())
    damaged["channels"][0]["mean"] += 1
    for content in (json.dumps(damaged), "{", "[]", '{"version": 0}'):
        path.write_text(content)
        assert dataset.statistics() == found
    assert "content_sha256" in path.read_text()
    assert (
        rema_data.Release(release.folder, cache=release.cache.folder.parent).steps(split="train").statistics() == found
    )


def test_a_cache_that_cannot_be_written(release: rema_data.Release, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, data: Any) -> None:
        raise rema_data.errors.StorageError("the disk is full")

    monkeypatch.setattr("rema_data.statistics.values.write_atomic", full)
    dataset = release.steps(split="val")
    assert dataset.statistics().steps == len(dataset)


def test_a_release_in_memory(release: rema_data.Release) -> None:
    memory = rema_data.Release(release.folder, cache="memory").steps()
    assert memory.statistics() == release.steps().statistics()
