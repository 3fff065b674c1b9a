"""The judge's main loop: ``run_evaluation`` takes a policy through observe, infer and simulate.

Read in this order: ``config`` (what is asked), ``run`` (the loop), ``plan`` (who is alive), ``observe`` and ``bank``,
``infer``, ``simulate``, ``audit`` (1 % once more), ``folder`` (``run.json`` and resuming), ``environment``, ``tally``
and ``summary``, ``backend`` (what tests exchange).
"""

from __future__ import annotations

from evaluator.rollout.backend import Backend, default_backend
from evaluator.runner.config import EvaluationConfig, EvaluationResult
from evaluator.runner.run import run_evaluation

__all__ = [
    "Backend",
    "EvaluationConfig",
    "EvaluationResult",
    "default_backend",
    "run_evaluation",
]
