"""What an environment shows: a photograph of the world before an action or after it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pybullet_data

from evaluator.render.preview import play, waiting_shot
from evaluator.render.studio import Studio
from rema_data import grid
from rema_data.schema import Situation

__all__ = ["Camera"]

SIZE = (640, 480)


class Camera:
    """A studio with both arms; renders in software, so that no display is needed."""

    def __init__(self) -> None:
        self._studio = Studio(pybullet_data.getDataPath())

    def before(self, situation: Situation) -> npt.NDArray[np.uint8]:
        """Hands that wait above the target, uint8 (480, 640, 3)."""
        target = situation.target
        shot = waiting_shot(situation, int(grid.snap(target.x_m, target.y_m, 0.0)))
        return self._studio.photograph(shot, size=SIZE)

    def after(self, situation: Situation, action: int) -> npt.NDArray[np.uint8]:
        """The moment in which the action ended, uint8 (480, 640, 3); it is simulated once more for that."""
        return self._studio.photograph(play(situation, action).after, size=SIZE)

    def close(self) -> None:
        """Release what it holds."""
        self._studio.close()
