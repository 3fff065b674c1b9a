"""Every parser that the trials know."""

from __future__ import annotations

from tests.mutations import data, runs

__all__ = ["PARSERS"]

PARSERS = (*data.PARSERS, *runs.PARSERS)
