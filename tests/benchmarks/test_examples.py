"""benchmarks/examples.py: it trains and scores in a reduced size, and docs/policies.md has what it measured."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.examples import LEARNED, PAGE, POLICIES, page
from tests.benchmarks.test_benchmarks import measured


def test_the_committed_page_is_made_from_the_committed_result() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert page(text) == text
    assert all(f"| {policy} |" in text for policy in POLICIES)


@pytest.mark.slow  # tests/examples trains and scores one of each at this size
def test_examples(tmp_path: Path) -> None:
    pytest.importorskip("sklearn")
    words = ("--release", "rema-sample", "--batches", "200", "--episodes", "10", "--output", str(tmp_path / "runs"))
    found = measured(tmp_path, "examples", *words)["numbers"]
    assert list(found["scores"]) == list(POLICIES) and list(found["training"]) == list(LEARNED)
    for policy in LEARNED:
        grasp = found["scores"][policy]["grasp"]
        assert grasp["eligible"] == 10 and grasp["successes"] > found["scores"]["random"]["grasp"]["successes"]
