"""Arms that are dressed for a picture move as those of the world."""

from __future__ import annotations

import pybullet_data

from evaluator.render.arms import dressed_urdf
from evaluator.sim.simulator import Simulator
from evaluator.sim.world import World
from tests.evaluator.sim.test_physics import situations


class _Dressed(Simulator):
    @property
    def world(self) -> World:
        if self._world is None:
            self._world = World(("left",), self.parameters, dressed_urdf(pybullet_data.getDataPath()))
        return self._world


def test_looks_change_nothing() -> None:
    jobs = situations(2)
    plain, dressed = Simulator(), _Dressed()
    assert [plain.run(*job) for job in jobs] == [dressed.run(*job) for job in jobs]
    plain.close()
    dressed.close()
