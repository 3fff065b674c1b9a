"""Evaluation sees every row once, whatever the number of ranks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rema_data.errors import InputError
from rema_data.samplers import EvaluationSampler


@settings(deadline=None)
@given(st.integers(0, 200), st.integers(1, 50), st.integers(1, 8))
def test_every_row_once_in_order(rows: int, batch: int, world: int) -> None:
    ranks = [EvaluationSampler(range(rows), batch, rank=rank, world_size=world) for rank in range(world)]
    parts = [list(sampler) for sampler in ranks]
    assert [len(sampler) for sampler in ranks] == [len(part) for part in parts]
    assert [row for part in parts for rows_ in part for row in rows_] == list(range(rows))
    assert all(len(piece) == batch for part in parts for piece in part[:-1])
    held = [sum(map(len, part)) for part in parts]
    assert max(held) - min(held) <= 1


@pytest.mark.parametrize("table", [{"task": ["a"] * 5}, pd.DataFrame({"task": ["a"] * 5}), np.zeros(5)])
def test_kinds_of_tables(table: Any) -> None:
    assert [batch.tolist() for batch in EvaluationSampler(table, 2)] == [[0, 1], [2, 3], [4]]


def test_refusals() -> None:
    with pytest.raises(InputError, match="batch_size=0"):
        EvaluationSampler(range(3), 0)
    with pytest.raises(InputError, match="no length"):
        EvaluationSampler(3)
