"""One evaluation: ``run_evaluation`` takes a policy through observe, infer and simulate."""

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
