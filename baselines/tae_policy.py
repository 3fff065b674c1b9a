"""The learned baselines: the network's map of success, and its best valid action.

``tae-joint`` and ``tae-separate`` are one class with two folders of networks: two that are shared by the skills of a
primitive, or one for every skill.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from baselines.tae.checkpoint import load_checkpoint, networks_in
from baselines.tae.scoring import Scorer
from evaluator.policy.interface import ObservationBatch
from rema_data import grid
from rema_data.errors import InputError
from rema_data.schema import Embodiment, Primitive, StepKind, skill

__all__ = ["TaePolicy"]


class TaePolicy:
    """The action with the highest score among the valid ones; the lowest grid index where several are equal.

    Parameters
    ----------
    checkpoint : Path
        A folder of networks, or one network (``NAME.safetensors``).
    device : str

    Raises
    ------
    MissingFileError, IntegrityError, InputError
        See ``baselines.tae.checkpoint.load_checkpoint``.
    """

    def __init__(self, checkpoint: Path | None = None, device: str = "cpu") -> None:
        if checkpoint is None:
            raise InputError(
                "a learned policy needs its networks", hint="name their folder: --checkpoint releases/checkpoints/..."
            )
        self._by_skill: dict[str, Scorer] = {}
        self._by_primitive: dict[str, Scorer] = {}
        self._folder = checkpoint
        for path in networks_in(checkpoint).values():
            network, about = load_checkpoint(path)
            scorer = Scorer(network, device)
            self._by_skill.update(dict.fromkeys(about.skills, scorer))
            self._by_primitive.setdefault(about.primitive, scorer)

    def act(self, observations: ObservationBatch) -> npt.NDArray[np.int64]:
        """Grid indices, int64 (N,)."""
        scores = self.maps(observations)
        masked = np.where(observations.valid[..., : scores.shape[-1]], scores, np.float32(-1))
        best = masked.reshape(len(scores), -1).argmax(axis=1)
        cell, k = np.divmod(best, scores.shape[-1])
        actions: npt.NDArray[np.int64] = cell * grid.ANGLES + k
        return actions

    def maps(self, observations: ObservationBatch) -> npt.NDArray[np.float32]:
        """Probability of success, float32 (N, 64, 64, K); K is 8 where two arms act as one and grasp, else 16."""
        kind = StepKind(Primitive(observations.primitive), Embodiment(observations.embodiment))
        scorer = self._by_skill.get(skill(kind), self._by_primitive.get(kind.primitive))
        if scorer is None:
            raise InputError(
                f"{self._folder} has no network for {kind.primitive}",
                hint="name a folder that has one",
                path=self._folder,
            )
        last = int(np.flatnonzero(observations.valid.any(axis=(0, 1, 2)))[-1])
        angles = grid.PAIR_ANGLES if last < grid.PAIR_ANGLES else grid.ANGLES
        return scorer.maps(observations.scene, observations.end_effector, angles)
