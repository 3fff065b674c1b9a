"""What a sampler does to the data: shares, repeats, weights, and a warning where rows repeat often."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from rema_data.samplers.shares import Shares
from rema_data.samplers.strata import Strata, label_text

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["SamplerReport", "StratumReport", "make_report"]

_MOST_REPEATS = 20.0
"""Repeats of a row above which the report warns."""


@dataclass(frozen=True, slots=True)
class StratumReport:
    """One stratum."""

    stratum: str  # ``task=grasp, success=True``
    rows: int
    natural: float  # share of the rows
    target: float  # share of the draws
    draws: float  # expected number
    repeats: float  # draws of every row
    weight: float  # natural over target share: the importance weight that makes a loss unbiased again


@dataclass(frozen=True, slots=True)
class SamplerReport:
    """All strata; printing it gives a table."""

    strata: tuple[StratumReport, ...]
    draws: int  # over all ranks
    warnings: tuple[str, ...]  # of strata that are drawn above their natural share, and whose rows repeat too often

    def to_frame(self) -> pd.DataFrame:
        """One row a stratum."""
        import pandas as pd

        return pd.DataFrame([asdict(row) for row in self.strata])

    def __str__(self) -> str:
        header = ("stratum", "rows", "natural", "target", "draws", "repeats", "weight")
        cells = [
            (
                row.stratum,
                f"{row.rows:,}",
                f"{row.natural:.2%}",
                f"{row.target:.2%}",
                f"{row.draws:,.0f}",
                f"{row.repeats:.2f}",
                f"{row.weight:.3g}",
            )
            for row in self.strata
        ]
        widths = [max(map(len, column)) for column in zip(header, *cells, strict=True)]
        lines = [
            "  ".join(
                cell.rjust(width) if place else cell.ljust(width)
                for place, (cell, width) in enumerate(zip(line, widths, strict=True))
            )
            for line in [header, *cells]
        ]
        return "\n".join([f"{self.draws:,} draws", *lines, *(f"warning: {text}" for text in self.warnings)])


def make_report(strata: Strata, shares: Shares, draws: int) -> SamplerReport:
    """Report on so many draws with these shares."""
    rows = []
    for label, size, share in zip(strata.labels, strata.sizes.tolist(), shares.tolist(), strict=True):
        natural, expected = size / len(strata.codes), share * draws
        text = label_text(strata.by, label)
        rows.append(StratumReport(text, size, natural, share, expected, expected / size, natural / share))
    warnings = tuple(
        f"each of the {row.rows:,} rows of {row.stratum} is drawn {row.repeats:.0f} times; augment, or weight the loss"
        for row in rows
        if row.repeats > _MOST_REPEATS and row.weight < 1
    )
    return SamplerReport(tuple(rows), draws, warnings)
