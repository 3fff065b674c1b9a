"""The contract of a policy as a pytest class: inherit it in your own tests, and name your policy.

::

    from evaluator.testing.policies import PolicyContract

    class TestMyPolicy(PolicyContract):
        policy = "my_package/my_policy.py:MyPolicy"  # a file, or the name of an installed policy
        checkpoint = "weights.safetensors"

Every test is one thing that `rema check` looks at: it fails where an evaluation or a submission would be refused, and
says how to fix it. The policy runs in its sandbox, as in an evaluation.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import pytest

from evaluator.policy.check import PolicyReport, check_policy

__all__ = ["PolicyContract"]


class PolicyContract:
    """What every policy must keep.

    Attributes
    ----------
    policy : str or Path
        Set it: ``my_policy.py``, ``my_policy.py:ClassName`` or the name of an installed policy.
    checkpoint : str, Path or None
        Its weights.
    device : str
    task : str, sequence of str or None
        All tasks by default.
    """

    policy: ClassVar[str | Path]
    checkpoint: ClassVar[str | Path | None] = None
    device: ClassVar[str] = "cpu"
    task: ClassVar[str | Sequence[str] | None] = None

    @pytest.fixture(scope="class")
    @classmethod
    def report(cls) -> PolicyReport:
        """What a check of the policy found."""
        return check_policy(cls.policy, task=cls.task, checkpoint=cls.checkpoint, device=cls.device)

    def test_it_loads_in_the_sandbox(self, report: PolicyReport) -> None:
        _assert_ok(report, "loads")

    def test_every_answer_is_a_valid_action(self, report: PolicyReport) -> None:
        _assert_ok(report, "valid actions")

    def test_the_same_question_has_the_same_answer(self, report: PolicyReport) -> None:
        _assert_ok(report, "same again")

    def test_a_new_process_gives_the_same_answers(self, report: PolicyReport) -> None:
        _assert_ok(report, "new process")

    def test_answers_do_not_depend_on_the_batch_size(self, report: PolicyReport) -> None:
        _assert_ok(report, "batch size")

    def test_answers_do_not_depend_on_the_order(self, report: PolicyReport) -> None:
        _assert_ok(report, "order")

    def test_it_is_fast_enough(self, report: PolicyReport) -> None:
        _assert_ok(report, "time")


def _assert_ok(report: PolicyReport, name: str) -> None:
    result = next((result for result in report.results if result.name == name), None)
    if result is None:  # what came before it failed
        pytest.skip(f"not reached: {report.results[-1].found}")
    assert result.status != "refused", f"{result.found}; to fix this: {result.fix}"
