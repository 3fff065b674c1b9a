"""Finished runs of the fake world, made once for a file; a test that changes one works on a copy."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from evaluator.runner import run_evaluation
from tests.evaluator.fakes import FakePolicyProcess, fake_backend, fake_config, write_fake_list

LONG = "grasp_grasp_push"
EPISODES = 120


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Manifests, a cache, and the runs ``short`` (conditional, with policy errors) and ``long`` (end to end)."""
    folder = tmp_path_factory.mktemp("replay")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("REMA_MANIFESTS", str(folder / "manifests"))
        patch.setenv("REMA_HOME", str(folder / "home"))
        for task in ("grasp", LONG):
            write_fake_list(folder / "manifests", task, 300)
        fields: dict[str, Any] = {"episodes": EPISODES, "engine": "inline", "audit_share": 0.0}
        faulty = fake_backend(FakePolicyProcess(faulty=0.05))
        run_evaluation(fake_config(folder / "short", **fields), backend=faulty)
        run_evaluation(fake_config(folder / "long", LONG, protocol="end-to-end", **fields), backend=fake_backend())
        yield folder


@pytest.fixture
def copy_of(home: Path, tmp_path: Path) -> Callable[[str], Path]:
    """``copy_of("short")`` is a copy of that run that a test may damage."""

    def copy(name: str) -> Path:
        return shutil.copytree(home / name, tmp_path / name)

    return copy


def with_value(table: pa.Table, column: str, row: int, value: Any) -> pa.Table:
    """The table with one value changed."""
    values = table.column(column).to_pylist()
    values[row] = value
    field = table.schema.field(column)
    return table.set_column(table.schema.names.index(column), field, pa.array(values, field.type))
