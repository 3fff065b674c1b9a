"""The lower half of the paper's Table 2, for reference."""

from __future__ import annotations

import json
from typing import Any

from evaluator.policy.loading import OWN_PREFIX
from rema_data.errors import MissingFileError
from rema_data.manifests import manifests_dir

__all__ = ["published_rate", "published_table"]


def published_table() -> dict[str, Any]:
    """``manifests/published/table2.json``.

    Raises
    ------
    MissingFileError
        It is not there.
    """
    path = manifests_dir() / "published" / "table2.json"
    if not path.is_file():
        raise MissingFileError(f"{path} does not exist", hint="install rema again", path=str(path))
    table: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return table


def published_rate(policy: str, task: str) -> float | None:
    """Published share in 0..1 of a built-in baseline (``random``, ``scripted``, ``tae-...``), if there is one."""
    rates: dict[str, float] = published_table()["success_percent"].get(policy.removeprefix(OWN_PREFIX), {})
    return rates[task] / 100 if task in rates else None
