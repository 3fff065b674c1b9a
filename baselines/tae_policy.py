"""The learned baselines: the network's map of success, and its best valid action.

``tae-joint`` and ``tae-separate`` are one class with two folders of networks: two that are shared by the skills of a
primitive, or one for every skill.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.special import expit

from baselines.tae.checkpoint import load_checkpoint, networks_in
from baselines.tae.scoring import Scorer
from evaluator.policy.contract import ObservationBatch
from rema_data import grid
from rema_data.errors import InputError
from rema_data.schema import Embodiment, Primitive, StepKind, skill

__all__ = ["TIE", "TaePolicy"]

TIE = 1e-4
"""Log odds this near are equal: a gripper turned by half is the same gripper, and only rounding tells the two apart."""


class TaePolicy:
    """The valid action with the highest score; the lowest grid index where several are equal (``TIE``).

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
        # Not of the probabilities: of a network that is sure, many round to 1, and the first of them is any of them.
        scores = self._log_odds(observations, best=True)
        masked = np.where(observations.valid[..., : scores.shape[-1]], scores, np.float32(-np.inf))
        flat = masked.reshape(len(scores), -1)
        best = (flat >= flat.max(axis=1, keepdims=True) - TIE).argmax(axis=1)
        cell, k = np.divmod(best, scores.shape[-1])
        actions: npt.NDArray[np.int64] = cell * grid.ANGLES + k
        return actions

    def maps(self, observations: ObservationBatch) -> npt.NDArray[np.float32]:
        """Probability of success, float32 (N, 64, 64, K); K is 8 where two arms act as one and grasp, else 16."""
        probabilities: npt.NDArray[np.float32] = expit(self._log_odds(observations))
        return probabilities

    def _log_odds(self, observations: ObservationBatch, best: bool = False) -> npt.NDArray[np.float32]:
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
        valid = observations.valid if best else None  # angles that cannot have the best action are then left out
        return scorer.log_odds(observations.scene, observations.end_effector, angles, valid)
