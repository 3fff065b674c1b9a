"""The benchmark of killed runs runs, in a reduced size."""

from __future__ import annotations

from pathlib import Path

import pytest

from .test_benchmarks import measured


@pytest.mark.benchmark
def test_a_killed_evaluator_leaves_the_same_bytes(tmp_path: Path) -> None:
    words = ("--kills", "1", "--episodes", "40", "--batch-size", "4")
    numbers = measured(tmp_path, "kills", *words)["numbers"]
    (kill,) = numbers["kills"]
    assert kill["victim"] == "evaluator" and kill["same"] and kill["starts"] > 1
    assert numbers["reference"] == {"asked": 70, "simulated": 70}  # 40, and 30 of the audit
