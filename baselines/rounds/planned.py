"""What a collection plan says, once every value is known to be usable: see ``baselines.rounds.plan``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from evaluator.policy.loading import PolicySpec
from rema_data.release.seal import Description
from rema_data.store.block import BlockKey

__all__ = ["BlockPlan", "CollectionPlan", "PolicyUse"]


@dataclass(frozen=True, slots=True)
class PolicyUse:
    """A behaviour policy: its code, weights and device.

    Attributes
    ----------
    spec : PolicySpec
    checkpoint : Path or None
    device : str
    """

    spec: PolicySpec
    checkpoint: Path | None = None
    device: str = "cpu"


@dataclass(frozen=True, slots=True)
class BlockPlan:
    """What one block is to hold.

    Attributes
    ----------
    key : BlockKey
    episodes : int
    policies : tuple of PolicyUse
        Of every step of the task.
    """

    key: BlockKey
    episodes: int
    policies: tuple[PolicyUse, ...]


@dataclass(frozen=True, slots=True)
class CollectionPlan:
    """A plan whose every value is known to be usable.

    Attributes
    ----------
    path : Path
        Of the file.
    about : Description
    seed : int
    blocks : tuple of BlockPlan
        To be played, in the order of the file.
    reused : tuple of int
        Rounds taken from the parent.
    parent : str or None
        Name or folder of a release.
    """

    path: Path
    about: Description
    seed: int
    blocks: tuple[BlockPlan, ...]
    reused: tuple[int, ...] = ()
    parent: str | None = None
