"""The leaderboard, from result files alone."""

from __future__ import annotations

from evaluator.leaderboard.board import PUBLISHED_REMARK, Board, find_runs, leaderboard
from evaluator.leaderboard.row import PUBLISHED, Row, published_rows, row_of

__all__ = ["PUBLISHED", "PUBLISHED_REMARK", "Board", "Row", "find_runs", "leaderboard", "published_rows", "row_of"]
