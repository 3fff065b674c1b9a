"""The first two questions to a policy's process: to restrict itself, and to load the policy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from evaluator.policy.faults import FaultReason
from evaluator.policy.load_errors import LoadFailure
from evaluator.policy.process import ChildFailure, ChildProcess
from evaluator.policy.sandbox.isolation import Isolation, isolation_of
from evaluator.policy.sandbox.launch_spec import LaunchSpec
from evaluator.policy.wire import TAGS, frame_parts

__all__ = ["CannotStart", "Started", "WrapperFailed", "confine", "load"]


class CannotStart(Exception):
    """The policy cannot be used."""

    def __init__(self, failure: LoadFailure) -> None:
        super().__init__(failure.message)
        self.failure = failure


class WrapperFailed(Exception):
    """Nothing starts in the wrapper that the user gave."""


@dataclass(frozen=True, slots=True)
class Started:
    """What the first process of a policy said; a later one must say the same."""

    isolation: Isolation
    tags: dict[str, bool]  # what its class says of itself

    def check(self, first: Started | None) -> None:
        """Raise CannotStart where this is not what the first process said: a run recorded that."""
        if first is None:
            return
        if first.isolation != self.isolation:
            raise CannotStart(LoadFailure(f"its sandbox is not the one of its first process: {self.isolation}"))
        for tag, was in first.tags.items():
            if self.tags[tag] != was:
                said = f"started again it has `{tag}` {self.tags[tag]}, at first it had {was}"
                raise CannotStart(LoadFailure(said))


def confine(child: ChildProcess, launch: LaunchSpec) -> Isolation:
    """Restrict the process, before anything of the policy is read; what is restricted."""
    try:
        report, _ = child.ask(frame_parts(launch.orders(child.folder)), launch.limits.start_s, 0)
    except ChildFailure as failure:
        if launch.sandbox is None:
            raise _late(failure, launch) from None
        raise WrapperFailed(str(failure)) from None
    return isolation_of(report, launch.sandbox)


def load(child: ChildProcess, launch: LaunchSpec, class_name: str, device: str) -> dict[str, bool]:
    """Load the policy; what its class says of itself."""
    copy = launch.snapshot
    order: dict[str, Any] = {
        "op": "load",
        "path": str(copy.policy),
        "import_root": None if copy.import_root is None else str(copy.import_root),
        "class_name": class_name,
        "checkpoint": None if copy.checkpoint is None else str(copy.checkpoint),
        "device": device,
    }
    try:
        header, _ = child.ask(frame_parts(order), launch.limits.start_s - child.waited_s, 0)
    except ChildFailure as failure:
        raise _late(failure, launch) from None
    if header.get("ok") is not True:
        raise CannotStart(LoadFailure.of(header))
    return {tag: header.get(tag) is True for tag in TAGS}


def _late(failure: ChildFailure, launch: LaunchSpec) -> CannotStart:
    late = failure.reason == FaultReason.TIMEOUT
    why = f"did not start within {launch.limits.start_s:g} s" if late else f"{failure} while it started"
    return CannotStart(LoadFailure(why))
