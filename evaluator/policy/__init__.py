"""Policies: what a submitter writes, how a policy is found, and the separate process that it runs in.

``contract`` is what a policy sees and answers; ``host`` is the evaluator's end of its process, ``child`` the policy's
end, ``wire`` the frames between both.
"""

from __future__ import annotations

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
