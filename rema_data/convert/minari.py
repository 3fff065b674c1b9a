"""Minari: one dataset a task, whose environment is that of ``evaluator.gym``.

::

    grasp_push-v1/
        data/metadata.json
        data/main_data.hdf5
            episode_0                       attributes: id, total_steps, options/scenario, and some of the episode
                observations/scene          (n + 1, 64, 64): the last one is there twice, as the environment gives it
                observations/end_effector   (n + 1, 112, 112, 4)
                observations/step           (n + 1,)
                actions                     (n,) grid index
                rewards, terminations, truncations
                infos/outcome, infos/is_success     (n + 1,): those of the reset say nothing
        rema/                               what ``rema import`` needs (``seal``)

The environment's ``valid`` is left out: Minari has no way to describe a mask of several axes. Blocks with varied
episodes are refused: the environment cannot play these.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, ClassVar

import h5py
import numpy as np
import numpy.typing as npt

from rema_data.convert.base import ExportedFile, ExportOptions, ExportPlan
from rema_data.convert.folders import FolderFormat, NewDataset
from rema_data.convert.hdf5_file import damaged, open_file, reading
from rema_data.convert.hdf5_parts import dataset as array_of
from rema_data.convert.hdf5_parts import part
from rema_data.convert.minari_writer import MAIN, METADATA, dataset_name, metadata, write_episodes
from rema_data.convert.pieces import PIECE_STEPS
from rema_data.convert.seal import SealedFolder
from rema_data.errors import InputError
from rema_data.progress import Progress
from rema_data.release.manifest import Manifest
from rema_data.storage import write_atomic
from rema_data.store.block import BlockReader
from rema_data.store.columns import VARIATION

__all__ = ["Minari"]

Array = npt.NDArray[Any]
_KEPT_MAPS = 64


class Minari(FolderFormat):
    """Minari's HDF5 storage."""

    name: ClassVar[str] = "minari"

    def folder(self, manifest: Manifest, task: str) -> str:
        """The name by which ``minari.load_dataset`` finds it."""
        return dataset_name(task)

    def check_options(self, options: ExportOptions) -> None:
        """See ``FolderFormat``."""
        super().check_options(options)
        if options.maps != "metres":
            raise InputError(
                "the format minari has heights in metres, as its environments do", hint="leave out --maps quantised"
            )

    def export(self, plan: ExportPlan, progress: Progress) -> list[ExportedFile]:
        """See ``Format``; InputError for varied episodes, which the environments do not have."""
        varied = [block.key.path for block in plan.blocks if _varies(plan.release.block(block))]
        if varied:
            raise InputError(
                f"{varied[0]} of {plan.release.manifest.name} has varied episodes, which the format minari cannot "
                "keep: its environments do not vary",
                hint="choose another format, or other blocks: --task, --round",
                blocks=varied,
            )
        return super().export(plan, progress)

    def write(self, dataset: NewDataset) -> None:
        """See ``FolderFormat``."""
        write_episodes(dataset)
        size = (dataset.folder / MAIN).stat().st_size
        write_atomic(dataset.folder / METADATA, metadata(dataset, size))

    def observations(self, dataset: SealedFolder, number: int, steps: int) -> Iterator[tuple[Array, Array]]:
        """See ``FolderFormat``."""
        entries = {block.key: block for block in dataset.manifest.blocks}
        counts = [entries[key].episodes for key in dataset.blocks]
        first = sum(counts[:number])
        path = dataset.path / MAIN
        with closing(open_file(path)) as file:
            maps, waiting = _Maps(file), list[tuple[Array, Array]]()
            for index in range(first, first + counts[number]):
                with reading(path):
                    waiting.append(maps(index))
                if sum(len(scenes) for scenes, _ in waiting) >= PIECE_STEPS:
                    yield _joined(waiting)
                    waiting = []
            if waiting:
                yield _joined(waiting)


def _varies(reader: BlockReader) -> bool:
    column = reader.episodes()[VARIATION]
    return bool(column.null_count < len(column))


class _Maps:
    """Reads the maps of episodes. Most hands are bare: what is stored as one of the last maps is not unpacked again."""

    def __init__(self, file: h5py.File) -> None:
        self._file = file
        self._unpacked: dict[tuple[np.dtype[Any], int, bytes], Array] = {}

    def __call__(self, episode: int) -> tuple[Array, Array]:
        """Scenes and end effectors of the steps of an episode, without the last one, which is there twice."""
        seen = part(self._file, f"episode_{episode}/observations")
        scenes, hands = (array_of(seen, kind) for kind in ("scene", "end_effector"))
        if hands.chunks != (1, *hands.shape[1:]):
            raise damaged(Path(self._file.filename), f"{hands.name} is not stored a map a chunk")
        return scenes[:-1][..., None], np.concatenate([self._hand(hands, step) for step in range(len(hands) - 1)])

    def _hand(self, stored: h5py.Dataset, step: int) -> Array:
        packed = stored.dtype, *stored.id.read_direct_chunk((step, *(0,) * (stored.ndim - 1)))
        if packed not in self._unpacked:
            if len(self._unpacked) >= _KEPT_MAPS:
                self._unpacked.clear()
            self._unpacked[packed] = np.asarray(stored[step : step + 1])
        return self._unpacked[packed]


def _joined(maps: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    scenes, end_effectors = (np.concatenate(arrays) for arrays in zip(*maps, strict=True))
    return scenes, end_effectors
