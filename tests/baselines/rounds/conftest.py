"""The fingerprint of the fake world, without a process to compute it in; and a release that was collected there."""

from __future__ import annotations

import pytest

from rema_data.release.folder import ReleaseFolder
from tests.baselines.rounds.fakes import collect_fake, write_plan
from tests.evaluator.fakes import fake_fingerprint


@pytest.fixture
def quick_fingerprint(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("baselines.rounds.collect.call_in_child", lambda target: fake_fingerprint())


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    """The release of the plan, collected once."""
    folder = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("baselines.rounds.collect.call_in_child", lambda target: fake_fingerprint())
        return collect_fake(write_plan(folder), folder).release
