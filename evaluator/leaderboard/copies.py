"""Runs and entries with the actions of another one: they are that one, whatever they are called."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence

from evaluator.leaderboard.eligibility import obstacles
from evaluator.leaderboard.verification import Record
from evaluator.policy.named import kind_of
from evaluator.run.actions import NOT_ASKED, encode_actions
from evaluator.run.entry import entry_folder
from evaluator.run.run import Run

__all__ = ["COPY_SHARE", "in_order", "near_copies", "once"]

COPY_SHARE = 0.9
"""Two policies that give more than this share of their answers alike are one with a few changes."""


def in_order(runs: Sequence[Run], records: Mapping[str, Record]) -> list[Run]:
    """Runs with the originals before their copies.

    First what is verified, and meets the conditions of a rank; of that, entries in the order in which they were
    recorded, others that come with rema, run folders (which show more than an entry), and other entries; of these,
    installed policies come before others, each by name and digest.
    """

    def place(run: Run) -> tuple[object, ...]:
        record = records.get(run.digest) if run.kind == "entry" else None
        installed = run.kind == "entry" and run.source.resolve().parent == entry_folder().resolve()
        number = record.number if record is not None else float("inf")
        known = kind_of(run.policy) is not None
        order = (number, not installed, run.kind == "entry", not known, run.policy, run.digest, str(run.source))
        return not run.verified, bool(obstacles(run)), *order

    return sorted(runs, key=place)


def once(runs: Sequence[Run]) -> tuple[list[Run], list[tuple[Run, Run]]]:
    """Runs without those that have all actions of an earlier one; and these, each with the one that it repeats."""
    kept: dict[tuple[str, ...], Run] = {}
    copies = []
    for number, run in enumerate(runs):
        key: tuple[str, ...] = (str(number),)
        if run.has_actions:
            key = (*run.comparable.values(), hashlib.sha256(encode_actions(run.actions)).hexdigest())
        elif run.provenance.policy_digest:  # an entry of format 1
            bits = (run.outcomes.success.tobytes().hex(), run.outcomes.eligible.tobytes().hex())
            key = (*run.comparable.values(), run.provenance.policy_digest, *bits)
        first = kept.setdefault(key, run)
        if first is not run:
            copies.append((run, first))
    return list(kept.values()), copies


def near_copies(runs: Sequence[Run], ranked: Sequence[int]) -> dict[int, int]:
    """Positions of those of the ``ranked`` runs that give almost the answers of an earlier one, and of that one."""
    found: dict[int, int] = {}
    for place, n in enumerate(ranked):
        for earlier in ranked[:place]:
            if earlier not in found and _alike(runs[n], runs[earlier]):
                found[n] = earlier
                break
    return found


def _alike(one: Run, other: Run) -> bool:
    if one.comparable != other.comparable or not (one.has_actions and other.has_actions):
        return False
    if one.actions.shape != other.actions.shape:
        return False
    asked = (one.actions != NOT_ASKED) | (other.actions != NOT_ASKED)
    return bool((one.actions == other.actions)[asked].mean() > COPY_SHARE) if asked.any() else False
