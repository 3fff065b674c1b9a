"""The leaderboard: verified results are ranked, others stand apart."""

from __future__ import annotations

from evaluator.leaderboard.board import PUBLISHED_REMARK, Board, apart, find_runs, leaderboard
from evaluator.leaderboard.naming import PUBLISHED
from evaluator.leaderboard.row import Row, published_rows, row_of

__all__ = [
    "PUBLISHED",
    "PUBLISHED_REMARK",
    "Board",
    "Row",
    "apart",
    "find_runs",
    "leaderboard",
    "published_rows",
    "row_of",
]
