"""One evaluation: ``run_evaluation`` takes a policy through observe, infer and simulate.

Read in this order: ``config`` (what is asked), ``run`` (the loop), ``questions`` and ``observation_cache``,
``audit`` (1 % again), ``finalize`` (tables, summary, seal), ``shards`` and ``merge``, ``quick``.
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
