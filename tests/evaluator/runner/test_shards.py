"""How the scenarios of a run are divided."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluator.runner.shards import RunShard
from rema_data.errors import InputError


@given(st.integers(1, 3000), st.integers(1, 500), st.data())
def test_parts_cover_all_scenarios_once_in_whole_batches(episodes: int, batch_size: int, data: st.DataObject) -> None:
    count = data.draw(st.integers(1, -(-episodes // batch_size)))
    parts = [RunShard(number, count).indices(episodes, batch_size) for number in range(1, count + 1)]
    assert [index for part in parts for index in part] == list(range(episodes))
    assert all(part and part.start % batch_size == 0 for part in parts)
    sizes = [-(-len(part) // batch_size) for part in parts]
    assert max(sizes) - min(sizes) <= 1


def test_more_parts_than_batches() -> None:
    assert len(RunShard(157, 157).indices(10_000, 64)) == 16
    with pytest.raises(InputError, match="157 batches"):
        RunShard(1, 158).indices(10_000, 64)


def test_written_as_number_and_count() -> None:
    assert RunShard.parse("2/8") == RunShard(2, 8)
    assert str(RunShard(2, 8)) == "2/8"
    for text in ("", "2", "2/", "0/8", "9/8", "-1/8", "1/0", "2/8/3", "a/b", " 2/8"):
        with pytest.raises(InputError):
            RunShard.parse(text)
