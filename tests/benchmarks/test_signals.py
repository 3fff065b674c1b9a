"""The benchmark of stopped verbs runs, in a reduced size."""

from __future__ import annotations

from pathlib import Path

import pytest

from .test_benchmarks import measured


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["export", "import", "collect", "train", "rounds", "merge", "download", "evaluate"])
def test_a_stopped_verb_ends_cleanly_and_is_done_by_running_it_again(verb: str, tmp_path: Path) -> None:
    numbers = measured(tmp_path, "signals", "--signals", "2", "--small", "--verbs", verb)["numbers"]
    assert all(row["clean"] and row["same"] and not row["left"] for row in numbers["signals"])
