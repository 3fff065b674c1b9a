"""What a run notes about its own repeats."""

from __future__ import annotations

from typing import Any

import pydantic
from pydantic import NonNegativeInt

from rema_data.validation import record

__all__ = ["Audit", "AuditNumbers"]


@record
class Audit:
    """How much of a run was repeated, and how much of that differed."""

    actions: NonNegativeInt
    action_flips: NonNegativeInt
    outcomes: NonNegativeInt
    outcome_flips: NonNegativeInt

    @pydantic.model_validator(mode="after")
    def _add_up(self) -> Audit:
        if self.action_flips > self.actions or self.outcome_flips > self.outcomes:
            raise ValueError("has more flips than repeats")
        return self


@record
class AuditNumbers(Audit):
    """As ``audit_summary`` gives it."""

    episodes: NonNegativeInt
    action_flips_ci95: tuple[float, float]
    outcome_flips_ci95: tuple[float, float]
    lost: NonNegativeInt
    flipped: list[dict[str, Any]]
