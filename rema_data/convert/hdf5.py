"""HDF5 in the layout of robomimic: one file a task.

::

    grasp.hdf5
        data                     attributes: total, env_args
            demo_0               attributes: num_samples, and every column of episodes.parquet
                obs/scene            (n, 64, 64, 1)
                obs/end_effector     (n, 112, 112, 4)
                next_obs/...         where it was asked for
                actions, rewards, dones, grid_index
        mask                     filter keys: names of demos
            train, val, valid, train_success, round_1, round_1_train, ...
        rema                     what robomimic does not know: attributes with the version and the options
            manifest             bytes of the release's manifest
            card                 its other files
            round-1/grasp/train  an array a column of steps.parquet; an episode begins at its attribute first_step

An import takes the maps from ``obs``, the columns of an episode from the attributes of its demo, and the columns of its
steps from ``rema``. The rest follows from these.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path

from rema_data.convert.base import ExportedFile, ExportPlan, Source
from rema_data.convert.hdf5_reader import expand, open_source
from rema_data.convert.hdf5_writer import write_file
from rema_data.progress import Progress

__all__ = ["Hdf5"]


class Hdf5:
    """robomimic's layout."""

    def export(self, plan: ExportPlan, progress: Progress) -> list[ExportedFile]:
        """See ``Format``."""
        tasks = dict.fromkeys(block.task for block in plan.blocks)
        return [write_file(plan, task, [b for b in plan.blocks if b.task == task], progress) for task in tasks]

    def read(self, sources: Sequence[Path], progress: Progress) -> AbstractContextManager[Source]:
        """See ``Format``."""
        return open_source(expand(sources), progress)
