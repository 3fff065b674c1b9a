"""``steps(where=...)``: exactly the steps that meet a condition, with an identity of their own."""

from __future__ import annotations

import pytest

import rema_data
from rema_data.errors import InputError, IntegrityError
from rema_data.loader.cache import MemoryCache
from rema_data.release.folder import ReleaseFolder

pytest.importorskip("duckdb", reason="conditions need DuckDB, part of the extra `query`")

WHERE = "target_shape == 'T' and lift_m < 0.1"


def test_the_steps_that_meet_it(release: rema_data.Release) -> None:
    dataset = release.steps(split="train", which="all", where=WHERE)
    steps = release.to_pandas()
    wanted = steps[(steps.split == "train") & (steps.target_shape == "T") & (steps.lift_m < 0.1)]
    names = ["task", "round", "episode", "step", "action", "success"]
    assert 0 < len(wanted) < len(release.steps(split="train", which="all"))
    assert dataset.table[names].astype(str).values.tolist() == wanted[names].astype(str).values.tolist()
    assert dataset[:].action.tolist() == wanted.action.tolist()


def test_it_joins_the_other_selections(release: rema_data.Release) -> None:
    options = {"tasks": ["grasp_push"], "rounds": [2], "skills": ["grasp"], "which": "picks"}
    whole = release.steps(**options)  # type: ignore[arg-type]
    part = release.steps(**options, where="episode_success or episode < 3")  # type: ignore[arg-type]
    table = release.episodes.query("task == 'grasp_push' and round == 2")
    solved = table[table.success | (table.episode < 3)]
    expected = whole.table.merge(solved[["split", "episode"]].astype(whole.table.dtypes[["split", "episode"]]))
    assert len(part) == len(expected) > 0


def test_its_identity_is_that_of_the_rows(release: rema_data.Release) -> None:
    """The condition's text does not matter, its rows do."""
    whole = release.steps(split="train", which="all")
    first, same, other = (
        release.steps(split="train", which="all", where=text) for text in ("k < 4", "not (k >= 4) and true", "k < 5")
    )
    mask = (whole.table.action % 16 < 4).to_numpy()
    assert first.fingerprint == same.fingerprint == whole.select(mask).fingerprint
    assert len({first.fingerprint, other.fingerprint, whole.fingerprint}) == 3
    sampler = rema_data.BalancedSampler(first, batch_size=2, by="success")
    with pytest.raises(InputError, match="count in another table"):
        other[next(iter(sampler))]
    with pytest.raises(InputError, match="belongs to another order of draws"):
        rema_data.BalancedSampler(other, batch_size=2, by="success").load_state_dict(sampler.state_dict())


def test_a_condition_that_nothing_meets(release: rema_data.Release) -> None:
    with pytest.raises(InputError, match="no step of this selection where k > 20"):
        release.steps(where="k > 20")


def test_tables_that_changed_since_they_were_decoded(small: ReleaseFolder) -> None:
    release = rema_data.Release(small, cache="memory")
    index = release.cache.index.copy()
    index["action"] = index["action"][::-1]
    release.cache = MemoryCache(release.cache.maps, index, release.cache.categories)
    with pytest.raises(IntegrityError, match="have changed since they were decoded"):
        release.steps(where="k >= 0")
