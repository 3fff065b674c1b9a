"""The evaluator's end of a policy: asks it in batches, and counts every violation of the contract as a fault."""

from __future__ import annotations

import logging

import numpy as np
import numpy.typing as npt

from evaluator.policy.contract import ObservationBatch
from evaluator.policy.faults import Answer, FaultReason, PolicyFault, check_answer, check_maps, reported_fault
from evaluator.policy.session import PolicySession
from rema_data import grid
from rema_data.errors import InputError
from rema_data.schema import Situation

__all__ = ["PolicyHost"]

_LOG = logging.getLogger(__name__)
_ACTION_BYTES = 3 * 8  # of one returned action: three of the longest numbers
_MAP_BYTES = grid.ACTIONS * 4
_WARNINGS = 3  # failed batches that are logged as warnings: the counts are in the summary


class PolicyHost(PolicySession):
    """A policy in its own process, as a context manager: see ``PolicySession`` for what it is made of and raises."""

    returned = ""
    """Type and shape of the last array that the policy returned."""
    _warned = 0

    def act(self, batch: ObservationBatch, situations: tuple[Situation, ...] | None = None) -> list[Answer]:
        """An action or a fault for every observation of ``batch``, in its order.

        Parameters
        ----------
        batch : ObservationBatch
        situations : tuple of Situation, or None
            Needed by a privileged policy, and never shown to another one.

        Raises
        ------
        InputError
            When a privileged policy is asked without situations.
        """
        if self._privileged and (situations is None or len(situations) != len(batch)):
            raise InputError("a privileged policy needs one situation an observation", hint="pass `situations`")
        if len(batch) == 0:
            return []
        self._asked += len(batch)
        shown = situations if self._privileged else None
        answers = self._ask(batch, shown, self._limits.batch_s)
        if isinstance(answers, list):
            return answers
        level = logging.WARNING if self._warned < _WARNINGS else logging.DEBUG
        self._warned += 1
        _LOG.log(level, "policy %s failed on a batch: %s: %s", self.spec.name, answers.reason, answers.detail)
        return [answers] if len(batch) == 1 else self._ask_one_by_one(batch, shown)

    def _ask_one_by_one(self, batch: ObservationBatch, shown: tuple[Situation, ...] | None) -> list[Answer]:
        """Find out which observations of a failed batch are faults.

        The result depends on this batch only: in a run that was resumed, or on another machine, another process asked
        the earlier batches, and the rows must not depend on that.
        """
        answers: list[Answer] = []
        single_s = min(self._limits.batch_s, self._limits.single_s)
        deaths = 0
        for n in range(len(batch)):
            single = self._ask(batch.one(n), None if shown is None else (shown[n],), single_s)
            answers += single if isinstance(single, list) else [single]
            lost = isinstance(single, PolicyFault) and single.reason != FaultReason.EXCEPTION
            deaths = deaths + 1 if lost else 0
            if deaths >= self._limits.deaths_in_row and isinstance(single, PolicyFault):
                return answers + [single] * (len(batch) - len(answers))
        return answers

    def _ask(
        self, batch: ObservationBatch, shown: tuple[Situation, ...] | None, seconds: float
    ) -> list[Answer] | PolicyFault:
        """Answers of a batch within ``seconds``, or the fault that left it without any."""
        reply = self.exchange("act", batch, shown, seconds, len(batch) * _ACTION_BYTES)
        if isinstance(reply, PolicyFault):
            return reply
        header, arrays = reply
        if header.get("ok") is True and "answer" in arrays:
            self.returned = f"{arrays['answer'].dtype} {_shape(arrays['answer'])}"
            return check_answer(arrays["answer"], batch.valid)
        fault = reported_fault(header)
        return fault if fault.reason == FaultReason.EXCEPTION else [fault] * len(batch)

    def maps(self, batch: ObservationBatch) -> npt.NDArray[np.float32] | PolicyFault:
        """The policy's scores of all actions, from its method ``maps(observations)``, which no policy has to have.

        Parameters
        ----------
        batch : ObservationBatch

        Returns
        -------
        float32 (N, 64, 64, K) with K from 1 to 16, or PolicyFault
            Of a batch that failed, nothing is asked again: no rate depends on it.
        """
        self._asked += len(batch)
        reply = self.exchange("maps", batch, None, self._limits.batch_s, len(batch) * _MAP_BYTES)
        if isinstance(reply, PolicyFault):
            return reply
        header, arrays = reply
        if header.get("ok") is True and "answer" in arrays:
            return check_maps(arrays["answer"], len(batch))
        return reported_fault(header)


def _shape(answer: npt.NDArray[np.generic]) -> str:
    return "(N,)" if answer.ndim == 1 else f"(N, {', '.join(map(str, answer.shape[1:]))})"
