"""Names and kinds on the board: an installed policy's belong to it alone, and are checked by its digest."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from evaluator.leaderboard.published import published_table
from evaluator.policy.loading import PolicySpec, resolve, weights_of
from evaluator.policy.named import KINDS, PRIVILEGED_KINDS, find_named, is_adapted, is_reserved, policy_names
from evaluator.policy.sandbox.snapshot import digest
from evaluator.run.run import Run
from rema_data.errors import RemaError

__all__ = ["PUBLISHED", "TAGS", "installed_digest", "name_problem"]

PUBLISHED = "published"
"""The tag of the paper's rows."""
TAGS = ("submitted", "simulator", *(kind for kind in KINDS if kind != "simulator"), PUBLISHED)
"""Kinds of rows."""
_OPEN = ("submitted", "simulator", "privileged")
"""Kinds of policies that are not installed."""


def name_problem(run: Run, name: str = "") -> str:
    """Why a run may not be shown under its name (or ``name``) and as its kind; empty where it may."""
    shown = name or run.policy
    if run.kind == "entry" and run.recorded is None:
        return ""  # of format 1: it has no rank in any case
    if shown in policy_names():
        return _installed_problem(run, shown)
    taken = {*policy_names()}
    if run.kind == "entry" or name:  # a local joint.py may be called joint: its tag says that it is not the paper's
        taken |= {*published_table()["success_percent"], *TAGS}
    if is_reserved(shown) or shown.casefold() in {one.casefold() for one in taken}:
        return f"{shown!r} is, or looks like, the name of an installed policy, a published one or a kind of policy"
    if run.kind == "entry" and run.tag not in _OPEN:
        return f"{run.tag!r} is a kind of installed policies, and {shown!r} is not one"
    return ""


def _installed_problem(run: Run, name: str) -> str:
    if run.policy != name and run.kind == "run":
        return f"{name!r} is the name of an installed policy, the run is of {run.policy!r}"
    if run.verified == "record":
        return ""  # it was checked when the record was made, by the version of the policy of that time
    own = installed_digest(name, run.task)
    if own and own != run.provenance.policy_digest:
        return f"{name!r} is the name of an installed policy, and the digest is that of another one or another version"
    kind = getattr(find_named(name), "kind", "")
    wanted = "privileged" if kind in PRIVILEGED_KINDS else kind
    if run.kind_of_policy and run.tag != wanted:
        return f"{name!r} is {wanted}, the entry says {run.tag}"
    if run.adapted != (adapted := is_adapted(name)):
        return f"{name!r} is installed as {'adapted' if adapted else 'clean-trained'}, the {run.kind} says otherwise"
    return "" if own or run.kind == "run" else f"{name!r} has no weights of its own: choose another name"


def installed_digest(name: str, task: str) -> str:
    """Digest of the installed policy of that name, with its own weights for a task; empty where it has none."""
    try:
        spec = resolve(name)
        weights = weights_of(spec, None, task)
        if weights is None and spec.named is not None and spec.named.kind == "learned":
            return ""
        return _digest(spec, weights)
    except RemaError:
        return ""


@lru_cache(maxsize=32)
def _digest(spec: PolicySpec, weights: Path | None) -> str:
    return digest(spec, weights)
