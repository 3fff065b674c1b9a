"""Frozen scenario lists: reading them, drawing them, tools that a policy picked, and strata.

Read in this order: ``table`` and ``lists`` (reading and writing), ``generation`` and ``policy_picks`` (drawing),
``strata``.
"""

from __future__ import annotations

from evaluator.scenarios.lists import (
    SPLITS,
    VERSION,
    ScenarioList,
    installed_list,
    list_length,
    load_list,
    manifest_path,
    scenario_id,
    update_manifest,
    versions,
    write_list,
)
from evaluator.scenarios.table import encode_list

__all__ = [
    "SPLITS",
    "VERSION",
    "ScenarioList",
    "encode_list",
    "installed_list",
    "list_length",
    "load_list",
    "manifest_path",
    "scenario_id",
    "update_manifest",
    "versions",
    "write_list",
]
