"""Checks that need no simulation: is this the same world, do the statistics follow, are the actions valid."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from evaluator.run.actions import NOT_ASKED, POLICY_ERROR
from evaluator.run.check import Evidence, Finding, row_name
from evaluator.run.counts import same_numbers, tally, unfinished
from evaluator.run.header import RUN_FILE
from evaluator.run.plan import Plan
from evaluator.run.seal import ACTIONS_FILE, EPISODES_FILE, SUMMARY_FILE
from evaluator.scenarios import ScenarioList, load_list
from evaluator.sim.bullet import decisive
from rema_data import grid
from rema_data.errors import RunMismatchError

__all__ = ["invalid_actions", "scenarios_of", "shortened", "statistics_findings", "world_differences"]

_IDENTITY = ("task", "split", "protocol", "policy_digest", "protocol_hash", "scenarios_hash", "fingerprint")
_SHOWN = 80
"""Characters of a value in a finding."""


def scenarios_of(evidence: Evidence) -> ScenarioList:
    """The list that a run was played on.

    Raises
    ------
    RunMismatchError
        It is not the one here.
    """
    identity = evidence.header["identity"]
    recorded = identity.get("scenarios_hash")
    scenarios = load_list(identity["task"], identity["split"])
    if scenarios.sha256 != recorded or evidence.header["episodes"] > len(scenarios.scenarios):
        raise RunMismatchError(
            f"{evidence.folder} was played on another scenario list than the one here: {recorded}, "
            f"here {scenarios.sha256}",
            hint="replay it with the version of rema that made it (`versions` in run.json)",
            recorded=recorded,
            here=scenarios.sha256,
        )
    return scenarios


def world_differences(
    identity: dict[str, Any], fingerprint: dict[str, str], protocol_hash: str
) -> dict[str, tuple[Any, Any]]:
    """In what the world here is not that of a run: entry to (recorded, here); empty where every bit must agree.

    Parameters
    ----------
    identity : dict
        Of the run.
    fingerprint : dict
        Of the simulator here.
    protocol_hash : str
        Of the run's task and protocol, here.
    """
    recorded = identity.get("fingerprint")
    known, here = decisive(recorded if isinstance(recorded, dict) else {}), decisive(fingerprint)
    pairs = {name: (known.get(name), here.get(name)) for name in sorted(known.keys() | here.keys())}
    pairs["protocol_hash"] = (identity.get("protocol_hash"), protocol_hash)
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}


def statistics_findings(evidence: Evidence, plan: Plan) -> Iterator[Finding]:
    """Entries of ``summary.json`` that do not follow from the rows, or from ``run.json``."""
    if evidence.summary is None or evidence.table is None:
        return
    identity, policy = evidence.header["identity"], evidence.header["policy"]
    rows = {**tally(evidence.table, plan.steps), "unfinished": unfinished(plan, evidence.table)}
    header = {
        **{name: identity.get(name) for name in _IDENTITY},
        "policy": policy.get("name"),
        "privileged": policy.get("privileged"),
        "merkle_root": evidence.seal["merkle_root"],
    }
    for source, content in ((EPISODES_FILE, rows), (RUN_FILE, header)):
        for name, value in json.loads(json.dumps(content)).items():
            said = evidence.summary.get(name)
            if not same_numbers(said, value):
                detail = f"says {shortened(said)}, {source} gives {shortened(value)}"
                yield Finding(SUMMARY_FILE, name, detail)


def invalid_actions(
    evidence: Evidence, plan: Plan, valid_actions: Callable[[str, int], npt.NDArray[np.bool_]]
) -> Iterator[Finding]:
    """Recorded actions that the protocol does not allow."""
    if evidence.actions is None:
        return
    for column, step in enumerate(plan.steps):
        valid = valid_actions(plan.task, step).reshape(grid.ACTIONS)
        taken = evidence.actions[:, column]
        for row in np.flatnonzero(~valid[taken] & (taken != POLICY_ERROR) & (taken != NOT_ASKED)).tolist():
            where = f"{row_name(evidence.table, row)}, step {step}"
            yield Finding(ACTIONS_FILE, where, f"action {taken[row]} is not a valid one")


def shortened(value: Any) -> str:
    """A value as JSON, cut where it is long."""
    text = json.dumps(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
