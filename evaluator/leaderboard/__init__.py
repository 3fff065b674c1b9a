"""The leaderboard, from result files alone.

Read in this order: ``row`` (what is shown), ``ranking`` (who is better), ``board`` (the whole), ``published`` (the
paper's rates).
"""

from __future__ import annotations

from evaluator.leaderboard.board import PUBLISHED_REMARK, Board, find_runs, leaderboard
from evaluator.leaderboard.row import PUBLISHED, Row, published_rows, row_of

__all__ = ["PUBLISHED", "PUBLISHED_REMARK", "Board", "Row", "find_runs", "leaderboard", "published_rows", "row_of"]
