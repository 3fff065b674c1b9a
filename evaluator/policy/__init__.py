"""Policies: what a submitter writes, how a policy is found, and the separate process that it runs in.

::

    contract  what a policy sees and what it answers
    named     the installed policies, found by entry points
    loading   "my_policy.py:Name" or an installed name  ->  PolicySpec (a file and a class, nothing imported)
    shipped   an installed name  ->  the networks that come with the repository
    check     some questions of every task  ->  what would be refused, and how to fix it
    host      the evaluator's end: batches, contract checks, restarts  ->  answers or counted faults
    process   one child process and its deadlines
    sandbox   how that process is started, and what confines it
    child     the policy's end: imports the file and answers batches
    wire      the frames between both ends
"""

from __future__ import annotations

from evaluator.policy.contract import ObservationBatch, Policy, PrivilegedPolicy
from evaluator.policy.faults import Answer, PolicyFault
from evaluator.policy.host import PolicyHost
from evaluator.policy.loading import PolicySpec, digest, resolve, weights_of
from evaluator.policy.named import NamedPolicy, find_named, kind_of, policy_names
from evaluator.policy.sandbox.isolation import Isolation, Restriction
from evaluator.policy.sandbox.limits import PolicyLimits

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
