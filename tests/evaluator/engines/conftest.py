"""A Ray cluster of two tiny machines, which are processes of this one."""

from __future__ import annotations

import importlib
import json
import secrets
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.evaluator.engines.cluster_world import FAULT_FILE

MACHINE = {"num_cpus": 1, "object_store_memory": 80 * 2**20, "include_dashboard": False}


@pytest.fixture(scope="module")
def faults_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cluster") / "faults.json"


@pytest.fixture(scope="module")
def cluster(faults_file: Path) -> Iterator[Any]:
    """A head and room for more; ``cluster.add_node(**MACHINE)`` adds a machine, ``remove_node`` kills it."""
    # In a folder of its own, with a short name (it holds sockets): a cluster of the user's stays the one that is found.
    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory(prefix="ray") as folder:
        patch.setenv(FAULT_FILE, str(faults_file))
        patch.setenv("RAY_TMPDIR", folder)
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_AUTH_MODE", "token")  # of its own, and not the one in the user's home; read at the import
        patch.setenv("RAY_AUTH_TOKEN", secrets.token_hex(32))
        ray = pytest.importorskip("ray", reason="Ray is not installed: the extra `ray`")
        started = importlib.import_module("ray.cluster_utils").Cluster(initialize_head=True, head_node_args=MACHINE)
        patch.setenv("RAY_ADDRESS", started.address)
        ray.init(log_to_driver=False, logging_level="ERROR")  # the engines share it
        yield started
        ray.shutdown()
        started.shutdown()


@pytest.fixture
def order(faults_file: Path) -> Callable[..., None]:
    """``order(die=[3])`` orders faults of the simulators that are started from now on; none at first."""

    def write(**faults: Any) -> None:
        faults_file.write_text(json.dumps(faults))

    write()
    return write
