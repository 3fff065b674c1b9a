"""The fingerprint of the fake world, without a process to compute it in."""

from __future__ import annotations

import pytest

from tests.evaluator.fakes import fake_fingerprint


@pytest.fixture
def quick_fingerprint(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("baselines.rounds.collect.call_in_child", lambda target: fake_fingerprint())
