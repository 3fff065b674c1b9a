"""What a policy sees and what it answers: the whole contract of a submission."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from rema_data.schema import Observation, Situation

__all__ = ["ObservationBatch", "Policy", "PrivilegedPolicy"]


@dataclass(frozen=True, slots=True, eq=False)
class ObservationBatch:
    """Observations of one step of one task: all that a policy sees.

    Attributes
    ----------
    scene : float32 (N, 64, 64)
        Height above the table, metres. Row i grows with world y, column j with world x; 4.5 mm a pixel.
    end_effector : float32 (N, 112, 112, 4)
        Depth (m) and mask of state 1, then depth and mask of state 2 of the hand or tool that acts, at yaw 0. The mask
        is 1 where the topmost body may touch the target.
    primitive : str
        ``grasp`` or ``push``.
    embodiment : str
        ``gripper``, ``tool``, ``sticks`` or ``pinched``.
    task : str
    step : int
        0-based position in the task.
    valid : bool (N, 64, 64, 16)
        Which actions (row i, column j, angle k) may be answered. Angle k is the yaw ``k * 2 pi / 16``.
    """

    scene: npt.NDArray[np.float32]
    end_effector: npt.NDArray[np.float32]
    primitive: str
    embodiment: str
    task: str
    step: int
    valid: npt.NDArray[np.bool_]

    @classmethod
    def of(
        cls, situation: Situation, observations: Sequence[Observation], valid: npt.NDArray[np.bool_]
    ) -> ObservationBatch:
        """Observations of one step; an end effector that they all have, as bare hands are, is held once.

        ``situation`` is any of those observed: it says which step this is. ``valid``, bool (64, 64, 16), is the same
        for all.
        """
        scene = np.stack([one.scene_m() for one in observations])
        first, *others = observations
        end_effector: npt.NDArray[np.float32]
        if all(np.array_equal(first.mask, one.mask) and np.array_equal(first.depth, one.depth) for one in others):
            shared = first.end_effector()
            end_effector = np.broadcast_to(shared, (len(scene), *shared.shape))
        else:
            end_effector = np.stack([one.end_effector() for one in observations])
        return cls(
            scene=scene,
            end_effector=end_effector,
            primitive=situation.kind.primitive.value,
            embodiment=situation.kind.embodiment.value,
            task=situation.task,
            step=situation.step,
            valid=np.broadcast_to(valid, (len(scene), *valid.shape)),
        )

    def __len__(self) -> int:
        """Number of observations N."""
        return len(self.scene)

    def one(self, index: int) -> ObservationBatch:
        """The batch that holds observation ``index`` alone."""
        return self.part(slice(index, index + 1))

    def part(self, numbers: slice) -> ObservationBatch:
        """The batch that holds some of the observations, in the order of ``numbers``."""
        end_effector, valid = self.end_effector[numbers], self.valid[numbers]
        return replace(self, scene=self.scene[numbers], end_effector=end_effector, valid=valid)


@runtime_checkable
class Policy(Protocol):
    """A policy, as a type to check a class against.

    It must not remember: the evaluator asks in any order, in any batch size, and in several processes. A class that
    carries a simulator of this world, or the scenario lists, says so: ``simulator = True``.

    Parameters
    ----------
    checkpoint : Path or None
        What the user gave as ``--checkpoint``.
    device : str
        What the user gave as ``--device``; ``cpu`` by default.

    Examples
    --------
    >>> import numpy as np
    >>> from evaluator.policy import ObservationBatch, Policy
    >>> class FirstValid:
    ...     def __init__(self, checkpoint: Path | None, device: str) -> None: ...
    ...     def act(self, observations: ObservationBatch) -> npt.NDArray[np.int64]:
    ...         return observations.valid.reshape(len(observations), -1).argmax(axis=1)
    >>> policy: Policy = FirstValid(None, "cpu")
    """

    def __init__(self, checkpoint: Path | None, device: str) -> None: ...

    def act(self, observations: ObservationBatch) -> npt.NDArray[Any]:
        """Answer an integer array: (N, 3) of i, j, k, or (N,) of grid indices ``(i * 64 + j) * 16 + k``."""
        ...


@runtime_checkable
class PrivilegedPolicy(Protocol):
    """A policy that is shown the ground truth; its rows on the leaderboard are marked ``privileged``."""

    privileged: ClassVar[bool] = True

    def __init__(self, checkpoint: Path | None, device: str) -> None: ...

    def act(self, observations: ObservationBatch, situations: tuple[Situation, ...]) -> npt.NDArray[Any]:
        """Like ``Policy.act``, with the situation behind every observation."""
        ...
