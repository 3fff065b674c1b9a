"""Hard failures: failed steps that the present weights score highest take the place of others in the minibatches.

A policy takes the best of 50,176 actions. What misleads it are the few failures that score like successes, and most of
the recorded ones are none of these: a random action that missed its object teaches little more once many were seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from baselines.tae.network import TaeNetwork
from baselines.train.config import TrainingConfig
from baselines.train.validation import log_odds
from rema_data.loader.dataset import StepDataset
from rema_data.samplers import BalancedSampler

__all__ = ["HardFailures"]

_CANDIDATES = 4
"""Failures that are scored for each one that is kept: the hardest quarter of every skill."""


class HardFailures:
    """Puts hard failures in place of a share of those that a sampler drew, skill by skill.

    Every look scores other candidates, so that all failures come up in time. Nothing is replaced before the first one.

    Parameters
    ----------
    data : StepDataset
        The training split.
    config : TrainingConfig
        Its ``hard_share`` and ``hard_every`` say how many are needed until the next look.
    """

    def __init__(self, data: StepDataset, config: TrainingConfig) -> None:
        self._share = config.hard_share
        self._rows = np.flatnonzero(~data.rows.success)
        self._failures = data.select(self._rows)
        self._skill = self._failures.table["skill"].astype(str).to_numpy()
        self._skill_of = dict(zip(self._rows.tolist(), self._skill.tolist(), strict=True))
        needed = config.hard_every * config.batch_size / 2 * config.hard_share
        count = max(1, round(_CANDIDATES * needed))
        self._candidates = BalancedSampler(
            self._failures,
            count,
            by="skill",
            num_samples=count,
            seed=config.seed,
            rank=0,
            world_size=1,
            rotate=True,
            shares={name: share for name, share in config.shares.items() if name in self._skill},
        )
        self._hard: dict[str, list[int]] = {}  # rows of ``data`` by skill
        self._met: dict[str, int] = {}  # failures that the sampler drew of a skill since the last look

    def look(self, network: TaeNetwork, device: torch.device) -> None:
        """Score the next candidates with the present weights, and keep the hardest of every skill."""
        drawn = np.array(next(iter(self._candidates)))
        scores, skills = log_odds(network, self._failures.select(drawn), device), self._skill[drawn]
        for name in sorted(set(skills.tolist())):
            own = np.flatnonzero(skills == name)
            hardest = own[np.argsort(-scores[own], kind="stable")[: max(1, len(own) // _CANDIDATES)]]
            # In the order of the draw: the hardest of all would otherwise come together in one minibatch.
            self._hard[name] = self._rows[drawn[np.sort(hardest)]].tolist()
        self._met = dict.fromkeys(self._hard, 0)

    def replaced(self, rows: Sequence[int]) -> list[int]:
        """The rows of a minibatch with hard failures among them, in the same places."""
        return [self._replaced(row) for row in rows]

    def _replaced(self, row: int) -> int:
        name = self._skill_of.get(row)  # None of a success
        if name is None or name not in self._hard:
            return row
        before, after = (int(self._share * (self._met[name] + n)) for n in (0, 1))
        self._met[name] += 1
        return self._hard[name][before] if before < after <= len(self._hard[name]) else row

    def state_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"candidates": self._candidates.state_dict(), "hard": dict(self._hard), "met": dict(self._met)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where a state was taken."""
        self._candidates.load_state_dict(state["candidates"])
        self._hard, self._met = state["hard"], state["met"]
