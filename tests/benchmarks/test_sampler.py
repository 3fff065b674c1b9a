"""The benchmark of the sampler runs, in a reduced size."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.benchmarks.test_benchmarks import measured


@pytest.mark.benchmark
def test_sampler(tmp_path: Path) -> None:
    words = ("--rows", "4000", "--large-rows", "5000", "--indices", "8192", "--repeats", "1")
    numbers = measured(tmp_path, "sampler", *words)["numbers"]
    for by_batch in numbers["indices_per_second"].values():
        assert set(by_batch) == {"8", "256"}
        assert min(by_batch.values()) > 0
    assert len(numbers["construction_s"]) == 3
    assert numbers["torch_limit"] == "draws"
