"""Derived results: what is packed comes back, what was edited does not, and nothing is unpacked beyond its size."""

from __future__ import annotations

import base64
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluator.run.actions import NOT_ASKED
from evaluator.run.counts import count_rows
from evaluator.run.derived import Derived, PackedRows, derived_of, inflate, recall, remember
from rema_data.schema import Failure
from rema_data.validation import validated
from tests.evaluator.runs import read_run, solved, use_installation, write_run

FINGERPRINT = {"probe": "p"}
LABELS = ("", "success", *sorted(label.value for label in (Failure.MISSED, Failure.POLICY_ERROR)))


def derived(codes: Any, steps: tuple[int, ...] = (0, 1)) -> Derived:
    return Derived(steps, LABELS, np.array(codes, np.uint8).reshape(-1, len(steps)), FINGERPRINT)


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), min_size=1, max_size=40))
def test_what_is_packed_comes_back(codes: list[tuple[int, int]]) -> None:
    made = derived(codes)
    rows = validated(PackedRows, made.pack(), "rows")
    found = Derived.unpack(rows, len(codes), (0, 1), FINGERPRINT)
    assert np.array_equal(found.codes, made.codes) and found.sha256 == made.sha256 == rows.sha256
    assert found.counts == made.counts


def test_counts_follow_from_the_last_step_that_was_reached() -> None:
    made = derived([(1, 1), (1, 2), (2, 0), (0, 0), (3, 0)])
    assert [made.label(row) for row in range(5)] == ["success", "missed", "missed", "", "policy_error"]
    counts = made.counts
    assert (counts.episodes, counts.eligible, counts.successes, counts.policy_errors) == (5, 4, 1, 1)
    assert counts.failures == {"missed": 2, "policy_error": 1}
    assert [(step.attempted, step.succeeded) for step in counts.funnel] == [(4, 2), (2, 1)]
    assert made.outcomes.eligible.tolist() == [True, True, True, False, True]
    assert made.outcomes.success.tolist() == [True, False, False, False, False]


def test_a_table_and_its_derived_rows_have_the_same_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use_installation(tmp_path, monkeypatch)
    passed = [solved(0.7, 1), solved(0.5, 2)]
    run = read_run(write_run(tmp_path / "run", passed, task="grasp_push", protocol="end-to-end"))
    assert derived_of(run.table, run.steps, FINGERPRINT).counts == count_rows(run.table, run.steps) == run.counts


@pytest.mark.parametrize(
    "changes",
    [
        {"sha256": "0" * 64},
        {"labels": ("", "success", "missed")},  # a code is not among them
        {"labels": ("", "success", "missed", "won")},
        {"labels": ("success", "", "missed", "policy_error")},
        {"codes": base64.b64encode(zlib.compress(bytes(9))).decode()},
    ],
)
def test_edited_rows_are_refused(changes: dict[str, Any]) -> None:
    rows = PackedRows(**{**derived([(1, 1), (1, 3), (2, 0)]).pack(), "labels": LABELS})
    Derived.unpack(rows, 3, (0, 1), FINGERPRINT)
    with pytest.raises(ValueError, match="its rows|does not hold"):
        Derived.unpack(replace(rows, **changes), 3, (0, 1), FINGERPRINT)


@pytest.mark.parametrize("data", [b"", b"12", bytes(5), bytes(1 << 24)])
def test_only_the_expected_size_is_inflated(data: bytes) -> None:
    with pytest.raises(ValueError, match="does not hold the 4 bytes"):
        inflate(base64.b64encode(zlib.compress(data)).decode(), 4)
    with pytest.raises(ValueError, match="cannot be decompressed"):
        inflate(base64.b64encode(b"no zlib stream").decode(), 4)
    assert inflate(base64.b64encode(zlib.compress(b"1234")).decode(), 4) == b"1234"


def test_what_is_remembered_is_of_these_actions_by_these_rules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REMA_HOME", str(tmp_path))
    rules, actions, made = {"task": "grasp"}, np.array([[7, 8], [9, NOT_ASKED]], np.uint16), derived([(1, 2), (2, 0)])
    remember("world", rules, actions, made)
    found = recall("world", rules, actions, (0, 1))
    assert found is not None and found.sha256 == made.sha256 and found.fingerprint == FINGERPRINT
    assert recall("other", rules, actions, (0, 1)) is None
    assert recall("world", {"task": "push"}, actions, (0, 1)) is None
    assert recall("world", rules, actions[::-1], (0, 1)) is None
    (path,) = (tmp_path / "verified").iterdir()
    for content in ("{", "[]", path.read_text().replace('"p"', "7")):
        path.write_text(content)
        assert recall("world", rules, actions, (0, 1)) is None
