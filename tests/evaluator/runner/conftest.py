"""What the runs of a file share that are simulated in the real world."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Folder of the runs of a file, which share their observations; the lists are those of the repository."""
    folder = tmp_path_factory.mktemp("real")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("REMA_HOME", str(folder / "cache"))
        patch.delenv("REMA_MANIFESTS", raising=False)
        yield folder
