"""The findings of a replay."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from evaluator.protocol import FLIP_LIMIT
from evaluator.run.check import Finding

__all__ = ["ReplayReport"]


@dataclass(frozen=True, slots=True)
class ReplayReport:
    """What a replay found."""

    run: str
    policy: str
    task: str
    protocol: str
    seal: str  # sha256 over results, action log and ``run.json``; hexadecimal
    episodes: int
    unfinished: int  # episodes without a result because the run was interrupted
    infra_errors: int  # episodes lost to the infrastructure
    fraction: float  # share of the measured episodes to simulate again
    seed: int | None  # with which they were drawn; None where all or none were
    replayed: int  # episodes simulated again
    lost: int  # those that could not be simulated here
    # (recorded, here) of the simulator: rows may then differ, which is not a finding
    differences: dict[str, tuple[Any, Any]]
    different_rows: int  # replayed rows of which any recorded value differed
    # Clopper-Pearson, among all measured rows: the upper end bounds the share of false rows
    different_ci95: tuple[float, float]
    flips: int  # replayed rows with another success or another label
    # Clopper-Pearson; its upper end decides whether another simulator confirms the run
    flips_ci95: tuple[float, float]
    audit: dict[str, Any] | None  # what the run says about its own repeats
    findings: tuple[Finding, ...]  # empty where everything is as it was sealed, and true

    @property
    def ok(self) -> bool:
        """Whether nothing was found."""
        return not self.findings

    @property
    def same_simulator(self) -> bool:
        """Whether the simulator here is that of the run, so that every bit must be the same."""
        return not self.differences

    @property
    def verified(self) -> bool:
        """Whether the replay confirms the run: nothing was found, and what was simulated agrees.

        Another simulator confirms it only where at most 0.5 % of the outcomes are others, at the 95 % upper bound.
        """
        return self.ok and self.replayed > 0 and (self.same_simulator or self.flips_ci95[1] <= FLIP_LIMIT)

    def to_dict(self) -> dict[str, Any]:
        """The report, ready for JSON."""
        head = {"ok": self.ok, "verified": self.verified, "same_simulator": self.same_simulator}
        return {**head, **asdict(self)}
