"""The report of a policy check: one result for every requirement, each with its fix."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from evaluator.policy.contract import ObservationBatch
from evaluator.policy.faults import Answer, FaultReason, PolicyFault
from evaluator.policy.sandbox.limits import PolicyLimits
from evaluator.protocol import ACTION_FLIP_LIMIT, FAULT_LIMIT, SCENARIOS

__all__ = ["CheckResult", "PolicyReport", "Same", "time_result", "validity_result"]

_SLOW_S = 1.0
_LIMITS = PolicyLimits()
_SCENARIOS = SCENARIOS["test"]
"""Of a full run."""
_FIXES = {
    FaultReason.EXCEPTION: "fix the line that is named; every task and step must be answered",
    FaultReason.TIMEOUT: f"answer faster: a batch of 64 has {_LIMITS.seconds(64):g} s, "
    f"one observation {_LIMITS.single_s:g} s",
    FaultReason.DIED: "look at what ended the process: memory, an exit, a crash in a library",
    FaultReason.RESTART: "make the constructor succeed in every new process",
    FaultReason.SHAPE: "return one action an observation: (N, 3) of i, j, k, or (N,) of (i * 64 + j) * 16 + k",
    FaultReason.DTYPE: "return integers: actions.astype(np.int64)",
    FaultReason.NAN: "return integers, and find out where the NaN comes from",
    FaultReason.RANGE: "i and j are 0 to 63, k is 0 to 15",
    FaultReason.INVALID: "choose among the actions that observations.valid allows, such as "
    "np.where(valid, scores, -np.inf).argmax()",
    FaultReason.PROTOCOL: "leave the file descriptors of the process alone",
}


@dataclass(frozen=True, slots=True)
class CheckResult:
    """The result for one requirement."""

    name: str
    # ``refused``: `rema evaluate` or `rema submit` would not take the policy
    status: Literal["ok", "warning", "refused"]
    found: str
    fix: str = ""  # what to do; empty where nothing is wrong


@dataclass(frozen=True, slots=True)
class PolicyReport:
    """The results of a check."""

    policy: str  # its name in tables
    file: Path
    class_name: str
    checkpoint: Path | None
    device: str
    tasks: tuple[str, ...]  # that it was asked about
    results: tuple[CheckResult, ...]
    privileged: bool = False
    isolation: str = ""  # level of the sandbox; empty where the process did not start
    decisions: int = 0  # observations that it was asked about
    seconds_per_decision: float | None = None  # in batches; None where it never answered
    peak_memory_bytes: int | None = None

    @property
    def ok(self) -> bool:
        """Whether nothing would be refused."""
        return all(result.status != "refused" for result in self.results)

    @property
    def projected_s(self) -> float | None:
        """Seconds that the policy needs for one decision in each of 10,000 scenarios."""
        return None if self.seconds_per_decision is None else _SCENARIOS * self.seconds_per_decision

    def to_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        return {
            "ok": self.ok,
            **asdict(self),
            "file": str(self.file),
            "checkpoint": None if self.checkpoint is None else str(self.checkpoint),
            "projected_s": self.projected_s,
        }


@dataclass(slots=True)
class Same:
    """Counts of answers that differed when only one condition was changed."""

    asked: int = 0
    example: str = ""
    differed: int = 0

    def compare(self, before: Sequence[Answer], now: Sequence[Answer], batch: ObservationBatch) -> None:
        """Count the answers about ``batch`` that differ."""
        for first, second in zip(before, now, strict=True):
            self.asked += 1
            if first != second:
                self.differed += 1
                where = f"{batch.task}, step {batch.step}"
                self.example = self.example or f"{_shown(first)}, then {_shown(second)} ({where})"

    def result(self, name: str, condition: str, fix: str) -> CheckResult:
        """The result; ``condition``: what was changed, such as ``"in a new process"``."""
        if not self.differed:
            return CheckResult(name, "ok", f"{self.asked} of {self.asked} answers were the same {condition}")
        found = f"{self.differed} of {self.asked} answers differed {condition}, such as {self.example}"
        if self.differed <= ACTION_FLIP_LIMIT * self.asked:
            return CheckResult(name, "warning", f"{found}; rounding can do that", fix)
        return CheckResult(name, "refused", found, fix)


def validity_result(answers: Sequence[Sequence[Answer]], returned: str) -> CheckResult:
    """The result for the validity of answers (a sequence a step); ``returned`` is the type and shape that came back."""
    every = [answer for part in answers for answer in part]
    faults = [answer for answer in every if isinstance(answer, PolicyFault)]
    if not faults:
        return CheckResult("valid actions", "ok", f"{len(every)} of {len(every)}; returned {returned}")
    reason = FaultReason(Counter(fault.reason for fault in faults).most_common(1)[0][0])
    example = next(fault for fault in faults if fault.reason == reason)
    share = max(sum(isinstance(answer, PolicyFault) for answer in part) / len(part) for part in answers)
    found = f"{len(every) - len(faults)} of {len(every)}; {reason}: {example.detail}"
    status: Literal["warning", "refused"] = "refused" if share > FAULT_LIMIT else "warning"
    return CheckResult("valid actions", status, found, _FIXES[reason])


def time_result(each_s: float, batch: int) -> CheckResult:
    """Whether an evaluation has the time for a policy that takes ``each_s`` for a decision in batches of ``batch``."""
    found = f"{_duration(each_s)} a decision, {_duration(_SCENARIOS * each_s)} for {_SCENARIOS:,} scenarios"
    batch_s, run_s = _LIMITS.seconds(batch), _LIMITS.run_s + _SCENARIOS * _LIMITS.observation_s
    if each_s * batch > batch_s or _SCENARIOS * each_s > run_s:
        fix = f"answer a batch of {batch} within {batch_s:g} s: use a faster --device, or a smaller network"
        return CheckResult("time", "refused", found, fix)
    if each_s > _SLOW_S:
        return CheckResult("time", "warning", found, "use a faster --device, or compute the batch as a whole")
    return CheckResult("time", "ok", found)


def _shown(answer: Answer) -> str:
    return answer.reason if isinstance(answer, PolicyFault) else str(answer)


def _duration(seconds: float) -> str:
    if seconds < 1:
        return f"{1000 * seconds:.1f} ms"
    if seconds < 120:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
