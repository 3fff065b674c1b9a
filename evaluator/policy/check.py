"""Check a policy before it is evaluated: some questions of every task in seconds, and what would be refused and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from evaluator.policy.faults import Answer, FaultReason, PolicyFault
from evaluator.policy.host import PolicyHost
from evaluator.policy.loading import PolicySpec, resolve, weights_of
from evaluator.policy.questions import Questions, questions
from evaluator.policy.sandbox.limits import PolicyLimits
from evaluator.protocol import ACTION_FLIP_LIMIT, FAULT_LIMIT
from rema_data.errors import SubmissionError
from rema_data.progress import Progress, Silent
from rema_data.schema import TASKS

__all__ = ["CheckResult", "PolicyReport", "check_policy"]

SCENARIOS = 10_000
"""Scenarios of a full run."""
_BATCH = 64
_SMALL_BATCH = 7
_REPEATED = 8
"""So many questions of a step are asked alone, again, and in a new process."""
_LEAST = 4
_OVERHEAD = 3 * _REPEATED + 2 * _SMALL_BATCH
_BUDGET_S = 20.0
"""Time that the policy is asked for, about: a slow one is asked less."""
_SLOW_S = 1.0
_LIMITS = PolicyLimits(batch_s=30.0, single_s=20.0, deaths_in_row=1)

_FIXES = {
    FaultReason.EXCEPTION: "fix the line that is named; every task and step must be answered",
    FaultReason.TIMEOUT: "answer faster: a batch of 64 has 60 s, one observation 20 s",
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
_PURE = (
    "answer from the observation alone: no random state (draw from a hash of the observation), no counters, no cache"
)
_ALONE = "treat every observation by itself: network.eval(), and no statistics over the batch"


@dataclass(frozen=True, slots=True)
class CheckResult:
    """One thing that was checked.

    Attributes
    ----------
    name : str
    status : {"ok", "warning", "refused"}
        ``refused``: `rema evaluate` or `rema submit` would not take the policy.
    found : str
    fix : str
        What to do; empty where nothing is wrong.
    """

    name: str
    status: Literal["ok", "warning", "refused"]
    found: str
    fix: str = ""


@dataclass(frozen=True, slots=True)
class PolicyReport:
    """What a check found.

    Attributes
    ----------
    policy : str
        Its name in tables.
    file : Path
    class_name : str
    checkpoint : Path or None
    device : str
    tasks : tuple of str
        That it was asked about.
    results : tuple of CheckResult
    privileged : bool
    isolation : str
        Level of the sandbox; empty where the policy's process did not start.
    decisions : int
        Observations that it was asked about.
    seconds_per_decision : float or None
        In batches; None where it never answered.
    peak_memory_bytes : int or None
    """

    policy: str
    file: Path
    class_name: str
    checkpoint: Path | None
    device: str
    tasks: tuple[str, ...]
    results: tuple[CheckResult, ...]
    privileged: bool = False
    isolation: str = ""
    decisions: int = 0
    seconds_per_decision: float | None = None
    peak_memory_bytes: int | None = None

    @property
    def ok(self) -> bool:
        """Whether nothing would be refused."""
        return all(result.status != "refused" for result in self.results)

    @property
    def projected_s(self) -> float | None:
        """Seconds that the policy needs for one decision in each of 10,000 scenarios."""
        return None if self.seconds_per_decision is None else SCENARIOS * self.seconds_per_decision

    def to_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        return {
            "ok": self.ok,
            **asdict(self),
            "file": str(self.file),
            "checkpoint": None if self.checkpoint is None else str(self.checkpoint),
            "tasks": list(self.tasks),
            "results": [asdict(result) for result in self.results],
            "projected_s": self.projected_s,
        }


def check_policy(
    policy: str | Path,
    *,
    task: str | Sequence[str] | None = None,
    checkpoint: str | Path | None = None,
    device: str = "cpu",
    sandbox: str | None = None,
    progress: Progress | None = None,
) -> PolicyReport:
    """Load a policy in the sandbox, ask it some questions of every task, and report what would be refused.

    Parameters
    ----------
    policy : str or Path
        ``my_policy.py``, ``my_policy.py:ClassName`` or the name of an installed policy.
    task : str or sequence of str, optional
        All tasks by default. The questions are the first validation scenarios; test scenarios are not used.
    checkpoint : str or Path, optional
        Weights, as for ``evaluate``.
    device : str
        Handed to the policy.
    sandbox : str, optional
        Wrapper of the policy's process, as for ``evaluate``.
    progress : Progress, optional

    Returns
    -------
    PolicyReport
        Also of a policy that does not load.

    Raises
    ------
    InputError
        There is no such policy or task, or the wrapper cannot be used.
    MissingFileError, IntegrityError
        The policy, its weights or a validation list is not there, or damaged.

    Examples
    --------
    >>> from evaluator import check_policy
    >>> report = check_policy("random", task="grasp")
    >>> report.ok
    True
    >>> [result.name for result in report.results]
    ['loads', 'valid actions', 'same again', 'new process', 'batch size', 'order', 'time', 'sandbox']
    """
    spec = resolve(str(policy))
    weights = weights_of(spec, None if checkpoint is None else Path(checkpoint))
    tasks = tuple(TASKS) if task is None else (task,) if isinstance(task, str) else tuple(task)
    progress = progress or Silent()
    progress.phase("observe", len(tasks))
    asked = []
    for name in tasks:
        asked += questions(name, _BATCH)
        progress.advance(1)
    return _Check(spec, weights, device, sandbox, tasks, asked, progress).report()


@dataclass(slots=True)
class _Same:
    """How often an answer was the same when only one thing was changed."""

    asked: int = 0
    example: str = ""
    differed: int = 0

    def compare(self, before: Sequence[Answer], now: Sequence[Answer], batch: Questions) -> None:
        for first, second in zip(before, now, strict=True):
            self.asked += 1
            if first != second:
                self.differed += 1
                where = f"{batch.batch.task}, step {batch.batch.step}"
                self.example = self.example or f"{_shown(first)}, then {_shown(second)} ({where})"


@dataclass(slots=True)
class _Check:
    """A check under way."""

    spec: PolicySpec
    weights: Path | None
    device: str
    sandbox: str | None
    tasks: tuple[str, ...]
    asked: list[Questions]
    progress: Progress
    answers: list[list[Answer]] = field(default_factory=list)
    returned: Counter[str] = field(default_factory=Counter)
    again: _Same = field(default_factory=_Same)
    fresh: _Same = field(default_factory=_Same)
    small: _Same = field(default_factory=_Same)
    order: _Same = field(default_factory=_Same)
    decisions: int = 0
    batched: int = 0
    batched_s: float = 0.0
    memory: int = 0

    def report(self) -> PolicyReport:
        facts: dict[str, Any] = {}
        try:
            with self._host() as host:
                facts = {"privileged": host.privileged, "isolation": host.isolation.level}
                start_s, sandbox = host.waited_s, str(host.isolation)
                self._first_process(host)
            if not self._hopeless:
                with self._host() as host:
                    self._second_process(host)
        except SubmissionError as error:
            message = error.message.removeprefix(f"policy {self.spec.name} cannot be used: ")
            results = [CheckResult("loads", "refused", message, error.hint)]
        else:
            results = [CheckResult("loads", "ok", f"in {start_s:.1f} s"), *self._results(sandbox, facts["isolation"])]
        return PolicyReport(
            self.spec.name,
            self.spec.path,
            self.spec.class_name,
            self.weights,
            self.device,
            self.tasks,
            tuple(results),
            **facts,
            decisions=self.decisions,
            seconds_per_decision=self.batched_s / self.batched if self.batched else None,
            peak_memory_bytes=self.memory or None,
        )

    def _host(self) -> PolicyHost:
        return PolicyHost(self.spec, self.weights, self.device, _LIMITS, sandbox=self.sandbox)

    @property
    def _hopeless(self) -> bool:
        """Whether it did not answer anything: asking more takes time and says no more."""
        return not any(isinstance(answer, int) for answers in self.answers for answer in answers)

    def _ask(self, host: PolicyHost, batch: Questions) -> list[Answer]:
        self.decisions += len(batch.situations)
        answers = host.act(batch.batch, batch.situations)
        if host.returned:
            self.returned[host.returned] += 1
        self.memory = max(self.memory, host.peak_memory_bytes or 0)
        return answers

    def _first_process(self, host: PolicyHost) -> None:
        """Every step: one question, then a batch, the same again, and in small batches."""
        single: list[list[Answer]] = []
        self.progress.phase("ask", 2 * len(self.asked))
        for batch in self.asked:
            single.append(self._ask(host, batch.part(slice(1))))
        if not any(isinstance(answer, int) for (answer,) in single):
            self.answers = single
            return
        start_s = host.waited_s
        for batch in self.asked:
            self._ask(host, batch.part(slice(1)))
        self._size(host.waited_s - start_s)
        for batch, alone in zip(self.asked, single, strict=True):
            start_s = host.waited_s
            answers = self._ask(host, batch)
            self.batched_s += host.waited_s - start_s
            self.batched += len(answers)
            self.answers.append(answers)
            self.small.compare(answers[:1], alone, batch)
            some = slice(_REPEATED)
            self.again.compare(answers[some], self._ask(host, batch.part(some)), batch)
            for begin in range(0, min(len(answers), 2 * _SMALL_BATCH), _SMALL_BATCH):
                part = slice(begin, begin + _SMALL_BATCH)
                self.small.compare(answers[part], self._ask(host, batch.part(part)), batch)
            self.progress.advance(1)

    def _size(self, seconds: float) -> None:
        """Cut the questions so that asking takes seconds; ``seconds``: for one of every step."""
        count = int(_BUDGET_S / max(seconds, 1e-9) - _OVERHEAD) // 2
        self.asked = [batch.part(slice(max(_LEAST, min(_BATCH, count)))) for batch in self.asked]

    def _second_process(self, host: PolicyHost) -> None:
        """The same batch in a new process, then the tasks and the batches in reverse order."""
        first = slice(_REPEATED)
        for batch, answers in zip(self.asked, self.answers, strict=True):
            self.fresh.compare(answers[first], self._ask(host, batch.part(first)), batch)
        for batch, answers in zip(reversed(self.asked), reversed(self.answers), strict=True):
            self.order.compare(answers[::-1], self._ask(host, batch.part(slice(None, None, -1))), batch)
            self.progress.advance(1)

    def _results(self, sandbox: str, level: str) -> Iterator[CheckResult]:
        yield self._validity()
        if not self._hopeless:
            yield self._sameness("same again", self.again, _PURE)
            yield self._sameness("new process", self.fresh, _PURE)
            yield self._sameness("batch size", self.small, _ALONE)
            yield self._sameness("order", self.order, _PURE)
            yield self._time()
        hint = "" if level != "L1" else "use Linux 6.2 or newer with libseccomp: see docs/threat_model.md"
        yield CheckResult("sandbox", "warning" if level == "L1" else "ok", sandbox, hint)

    def _validity(self) -> CheckResult:
        every = [answer for answers in self.answers for answer in answers]
        faults = [answer for answer in every if isinstance(answer, PolicyFault)]
        shape = self.returned.most_common(1)[0][0] if self.returned else ""
        if not faults:
            return CheckResult("valid actions", "ok", f"{len(every)} of {len(every)}; returned {shape}")
        reason = FaultReason(Counter(fault.reason for fault in faults).most_common(1)[0][0])
        example = next(fault for fault in faults if fault.reason == reason)
        share = max(
            sum(isinstance(answer, PolicyFault) for answer in answers) / len(answers) for answers in self.answers
        )
        found = f"{len(every) - len(faults)} of {len(every)}; {reason}: {example.detail}"
        status: Literal["warning", "refused"] = "refused" if share > FAULT_LIMIT else "warning"
        return CheckResult("valid actions", status, found, _FIXES[reason])

    def _sameness(self, name: str, same: _Same, fix: str) -> CheckResult:
        if not same.differed:
            return CheckResult(name, "ok", f"{same.asked} of {same.asked} answers were the same")
        found = f"{same.differed} of {same.asked} answers differed, such as {same.example}"
        if same.differed <= ACTION_FLIP_LIMIT * same.asked:
            return CheckResult(name, "warning", f"{found}; rounding may do that", fix)
        return CheckResult(name, "refused", found, fix)

    def _time(self) -> CheckResult:
        each_s = self.batched_s / self.batched
        found = f"{_duration(each_s)} a decision, {_duration(SCENARIOS * each_s)} for {SCENARIOS:,} scenarios"
        real = PolicyLimits()
        if each_s * _BATCH > real.batch_s or SCENARIOS * each_s > real.run_s + SCENARIOS * real.observation_s:
            fix = f"answer a batch of {_BATCH} within {real.batch_s:g} s: use a faster --device, or a smaller network"
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
