from __future__ import annotations

import pytest

from evaluator.run.plan import scenario_list
from evaluator.scenarios import load_list, versions
from rema_data.errors import RunMismatchError


def test_a_run_on_an_earlier_list_finds_it() -> None:
    """The lists of grasp_push differ between the versions, and both are in the repository."""
    for version in ("v1", "v2"):
        listed = load_list("grasp_push", "val", version)
        identity = {"task": "grasp_push", "split": "val", "scenarios_hash": listed.sha256}
        assert scenario_list({"identity": identity, "episodes": 2000}).version == version
    assert {"v1", "v2"} <= set(versions())


def test_a_list_that_is_not_here_is_named() -> None:
    identity = {"task": "grasp", "split": "val", "scenarios_hash": "x" * 64}
    with pytest.raises(RunMismatchError, match="than the ones here: xxx"):
        scenario_list({"identity": identity, "episodes": 1})
