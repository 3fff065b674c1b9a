"""Seeds of fresh lists: what an organiser commits to, and the names of the lists. Imports no simulator."""

from __future__ import annotations

import hashlib

from evaluator.scenarios.lists import FRESH
from rema_data.errors import InputError

__all__ = ["commitment", "count_of", "fresh_version", "seed_of"]

_MOST = 2**63


def fresh_version(seed: int, count: int) -> str:
    """Name of a fresh list; InputError for a seed that is none."""
    if not 0 <= seed < _MOST:
        raise InputError(f"the seed {seed} is not in 0 .. {_MOST - 1}", hint="give another number to --fresh")
    return f"{FRESH}{seed}-{count}"


def seed_of(version: str) -> str:
    """The seed in the name of a fresh list."""
    return version.removeprefix(FRESH).partition("-")[0]


def count_of(version: str) -> str:
    """The number of scenarios in the name of a fresh list."""
    return version.rpartition("-")[2]


def commitment(seed: int) -> str:
    """What an organiser publishes before an evaluation, and everybody can check when the seed is published: sha256."""
    return hashlib.sha256(f"rema fresh commitment {seed}".encode()).hexdigest()
