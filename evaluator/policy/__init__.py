"""Policies: what a submitter writes, how it is found, and the separate process that it runs in.

::

    loading   "my_policy.py:Name" or a built-in name  ->  PolicySpec (a file and a class, nothing imported)
    shipped   a built-in name  ->  the networks that come with the repository
    host      the judge's end: batches, contract checks  ->  answers or counted faults
    session   one child process: deadlines, the time of all questions, restarts
    enclosure what that process is started with: command, environment, limits, what it may reach
    walls     inside it, before anything of the policy is read: the kernel denies the rest
    child     the policy's end: imports the file and answers batches
    wire      the frames between both ends
"""

from __future__ import annotations

from evaluator.policy.contract import ObservationBatch, Policy, PrivilegedPolicy
from evaluator.policy.faults import Answer, PolicyFault
from evaluator.policy.host import PolicyHost
from evaluator.policy.loading import PolicySpec, digest, resolve, weights_of
from evaluator.policy.named import NamedPolicy, find_named, kind_of, policy_names
from evaluator.policy.sandbox.isolation import Isolation, Wall
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
    "Wall",
    "digest",
    "find_named",
    "kind_of",
    "policy_names",
    "resolve",
    "weights_of",
]
