"""The statistics of the tables.

``rates`` (one policy), ``pairs`` (two policies on the same scenarios), ``methods`` (ways of training, over seeds),
``families`` (many comparisons at once) and ``sequential`` (looking early).
"""

from __future__ import annotations

from evaluator.statistics.families import benjamini_hochberg, holm, tie_letters
from evaluator.statistics.methods import MethodDifference, MethodRate, method_difference, method_rate
from evaluator.statistics.pairs import PairTable, detectable_difference, midp_mcnemar, pair_table, paired_interval
from evaluator.statistics.rates import (
    clopper_pearson,
    difference_interval,
    error_bounds,
    format_interval,
    format_rate,
    percent,
    rate_interval,
    wilson,
    z_against_published,
)
from evaluator.statistics.sequential import QuickLook, QuickResult, difference_sequence, log_e_value, rate_sequence

__all__ = [
    "MethodDifference",
    "MethodRate",
    "PairTable",
    "QuickLook",
    "QuickResult",
    "benjamini_hochberg",
    "clopper_pearson",
    "difference_interval",
    "detectable_difference",
    "difference_sequence",
    "error_bounds",
    "format_interval",
    "format_rate",
    "holm",
    "log_e_value",
    "method_difference",
    "method_rate",
    "midp_mcnemar",
    "pair_table",
    "paired_interval",
    "percent",
    "rate_interval",
    "rate_sequence",
    "tie_letters",
    "wilson",
    "z_against_published",
]
