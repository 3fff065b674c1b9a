"""A run that takes no time: the summary that a real one would write."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Summary = Callable[..., dict[str, Any]]


def make_summary(**changes: Any) -> dict[str, Any]:
    """A plausible ``summary.json`` object."""
    summary = {
        "task": "grasp",
        "policy": "random",
        "privileged": False,
        "protocol": "conditional",
        "episodes": 1000,
        "eligible": 1000,
        "successes": 56,
        "success_rate": 0.056,
        "ci95": [0.0434, 0.0721],
        "success_rate_bounds": [0.056, 0.056],
        "failures": {"missed": 800, "blocked": 140, "policy_error": 4},
        "policy_errors": 4,
        "infra_errors": 0,
        "funnel": [],
        "seconds": {"observe": 1.0, "infer": 0.5, "simulate": 8.0, "total": 9.7},
        "episodes_per_second": 103.1,
        "workers": 2,
        "protocol_hash": "p",
        "scenarios_hash": "s",
        "fingerprint": {"pybullet": "3.2.7"},
    }
    return {**summary, **changes}


@pytest.fixture
def write_run(tmp_path: Path) -> Callable[..., Path]:
    """``write_run(name, **changes)`` writes a run folder."""

    def write(name: str, **changes: Any) -> Path:
        folder = tmp_path / "runs" / name
        folder.mkdir(parents=True)
        (folder / "summary.json").write_text(json.dumps(make_summary(**changes)))
        return folder

    return write
