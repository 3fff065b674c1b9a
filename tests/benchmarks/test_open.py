"""The benchmark of opening runs, in a reduced size."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.benchmarks.test_benchmarks import measured


@pytest.mark.benchmark
def test_opening(tmp_path: Path) -> None:
    numbers = measured(tmp_path, "open", "--steps", "300", "--repeats", "1")["numbers"]
    assert numbers["counts"]["steps"] >= 300
    assert 0 < numbers["calls_s"] < numbers["after_torch_s"]
    for row in numbers["decode"].values():
        assert row["bytes"] > 300 * 64 * 64 * 2
        assert 0 < row["parts"]["reading and decompressing"] < row["total"]
