"""Policies: what a submitter writes, how a policy is found, and the separate process that it runs in.

``contract`` is what a policy sees and answers; ``host`` is the evaluator's end of its process, ``child`` the policy's
end, ``wire`` the frames between both. The names below are imported when they are first used: the policy's process is
restricted before numpy starts its threads.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from evaluator.policy.contract import ObservationBatch, Policy, PrivilegedPolicy
    from evaluator.policy.faults import Answer, PolicyFault
    from evaluator.policy.host import PolicyHost
    from evaluator.policy.loading import PolicySpec, resolve, weights_of
    from evaluator.policy.named import NamedPolicy, find_named, kind_of, policy_names
    from evaluator.policy.sandbox.isolation import Isolation, Restriction
    from evaluator.policy.sandbox.limits import PolicyLimits
    from evaluator.policy.sandbox.snapshot import digest

__all__ = [
    "Answer",
    "Isolation",
    "NamedPolicy",
    "ObservationBatch",
    "Policy",
    "PolicyFault",
    "PolicyHost",
    "PolicyLimits",
    "PolicySpec",
    "PrivilegedPolicy",
    "Restriction",
    "digest",
    "find_named",
    "kind_of",
    "policy_names",
    "resolve",
    "weights_of",
]

_HOMES = {
    "contract": ("ObservationBatch", "Policy", "PrivilegedPolicy"),
    "faults": ("Answer", "PolicyFault"),
    "host": ("PolicyHost",),
    "loading": ("PolicySpec", "resolve", "weights_of"),
    "named": ("NamedPolicy", "find_named", "kind_of", "policy_names"),
    "sandbox.isolation": ("Isolation", "Restriction"),
    "sandbox.limits": ("PolicyLimits",),
    "sandbox.snapshot": ("digest",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'evaluator.policy' has no attribute {name!r}")
    value = getattr(import_module(f"evaluator.policy.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
