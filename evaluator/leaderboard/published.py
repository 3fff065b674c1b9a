"""The lower half of the paper's Table 2, for reference."""

from __future__ import annotations

from typing import Any

from evaluator.policy.named import find_named
from rema_data.manifests import manifests_dir, read_manifest

__all__ = ["published_rate", "published_table"]


def published_table() -> dict[str, Any]:
    """Content of ``manifests/published/table2.json``."""
    return read_manifest(manifests_dir() / "published" / "table2.json", "the table of published numbers", dict)


def published_rate(policy: str, task: str) -> float | None:
    """Published share in 0..1 of an installed policy that the paper has a row of, if there is one."""
    named = find_named(policy)
    rates: dict[str, float] = published_table()["success_percent"].get(named.published if named else "", {})
    return rates[task] / 100 if task in rates else None
