"""Check a policy before it is evaluated: ask it about every task for some seconds, and report what would be refused."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from evaluator.policy.check_report import CheckResult, PolicyReport, Same, time_result, validity_result
from evaluator.policy.faults import Answer
from evaluator.policy.host import PolicyHost
from evaluator.policy.loading import PolicySpec, resolve, weights_of
from evaluator.policy.questions import Questions, questions
from evaluator.policy.sandbox.limits import PolicyLimits
from rema_data.errors import SubmissionError
from rema_data.progress import Progress, Silent
from rema_data.schema import TASKS

__all__ = ["CheckResult", "PolicyReport", "check_policy"]

_BATCH = 64
_SMALL_BATCH = 7
_REPEATED = 8
"""Questions of a step that are asked again, and in a new process."""
_LEAST = 4
_OVERHEAD = 3 * _REPEATED + 2 * _SMALL_BATCH
_BUDGET_S = 20.0
"""Time for all questions, about: a slow policy is asked fewer."""
_LIMITS = PolicyLimits(batch_s=30.0, single_s=20.0, deaths_in_row=1)

_PURE = (
    "answer from the observation alone: no random state (draw from a hash of the observation), no counters, no cache"
)
_ALONE = "treat every observation by itself: network.eval(), and no statistics over the batch"


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
    tasks = (task,) if isinstance(task, str) else tuple(task or TASKS)
    given = None if checkpoint is None else Path(checkpoint)
    weights = weights_of(spec, given, tasks[0] if len(tasks) == 1 else None)
    progress = progress or Silent()
    progress.phase("observe", len(tasks))
    asked = []
    for name in tasks:
        asked += questions(name, _BATCH)
        progress.advance(1)
    return _Check(spec, weights, device, sandbox, tasks, asked, progress).report()


@dataclass(slots=True)
class _Check:
    """A check that is running."""

    spec: PolicySpec
    weights: Path | None
    device: str
    sandbox: str | None
    tasks: tuple[str, ...]
    asked: list[Questions]
    progress: Progress
    answers: list[list[Answer]] = field(default_factory=list)
    returned: Counter[str] = field(default_factory=Counter)
    same: defaultdict[str, Same] = field(default_factory=lambda: defaultdict(Same))
    decisions: int = 0
    batched: int = 0
    batched_s: float = 0.0
    memory: int = 0

    def report(self) -> PolicyReport:
        facts: dict[str, Any] = {}
        try:
            with PolicyHost(self.spec, self.weights, self.device, _LIMITS, sandbox=self.sandbox) as host:
                facts = {"privileged": host.privileged, "isolation": host.isolation.level}
                start_s, sandbox = host.waited_s, str(host.isolation)
                self._first_process(host)
            if not self._hopeless:
                with PolicyHost(self.spec, self.weights, self.device, _LIMITS, sandbox=self.sandbox) as host:
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

    @property
    def _hopeless(self) -> bool:
        """Whether it gave no valid answer: more questions would take time and show nothing new."""
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
        self.progress.phase("ask", 2 * len(self.asked))
        self.answers = single = [self._ask(host, batch.part(slice(1))) for batch in self.asked]
        if self._hopeless:
            return
        start_s = host.waited_s
        for batch in self.asked:
            self._ask(host, batch.part(slice(1)))
        # So many questions of every step that all of them take about _BUDGET_S.
        count = int(_BUDGET_S / max(host.waited_s - start_s, 1e-9) - _OVERHEAD) // 2
        self.asked = [batch.part(slice(max(_LEAST, min(_BATCH, count)))) for batch in self.asked]
        self.answers = []
        for batch, alone in zip(self.asked, single, strict=True):
            start_s = host.waited_s
            answers = self._ask(host, batch)
            self.batched_s += host.waited_s - start_s
            self.batched += len(answers)
            self.answers.append(answers)
            self.same["batch size"].compare(answers[:1], alone, batch.batch)
            some = slice(_REPEATED)
            self.same["same again"].compare(answers[some], self._ask(host, batch.part(some)), batch.batch)
            for begin in range(0, min(len(answers), 2 * _SMALL_BATCH), _SMALL_BATCH):
                part = slice(begin, begin + _SMALL_BATCH)
                self.same["batch size"].compare(answers[part], self._ask(host, batch.part(part)), batch.batch)
            self.progress.advance(1)

    def _second_process(self, host: PolicyHost) -> None:
        """The same batch in a new process, then the tasks and the batches in reverse order."""
        first = slice(_REPEATED)
        for batch, answers in zip(self.asked, self.answers, strict=True):
            self.same["new process"].compare(answers[first], self._ask(host, batch.part(first)), batch.batch)
        for batch, answers in zip(reversed(self.asked), reversed(self.answers), strict=True):
            self.same["order"].compare(answers[::-1], self._ask(host, batch.part(slice(None, None, -1))), batch.batch)
            self.progress.advance(1)

    def _results(self, sandbox: str, level: str) -> Iterator[CheckResult]:
        returned = self.returned.most_common(1)
        yield validity_result(self.answers, returned[0][0] if returned else "")
        if not self._hopeless:
            largest = len(self.asked[0].situations)
            for name, condition, fix in (
                ("same again", "when it was asked again", _PURE),
                ("new process", "in a new process", _PURE),
                ("batch size", f"in batches of 1, {_SMALL_BATCH} and {largest}", _ALONE),
                ("order", "in reverse order", _PURE),
            ):
                yield self.same[name].result(name, condition, fix)
            yield time_result(self.batched_s / self.batched, _BATCH)
        fix = "" if level != "L1" else "use Linux 6.2 or newer with libseccomp: see docs/threat_model.md"
        yield CheckResult("sandbox", "warning" if level == "L1" else "ok", sandbox, fix)
