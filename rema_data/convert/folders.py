"""Formats whose export is one sealed folder a task: what they share, so that each of them has to know its layout only.

The folder has the layout of the format, and the tables of the exported blocks as they are in the release (``seal``). An
import takes the maps from the layout and everything else from these tables.
"""

from __future__ import annotations

import shutil
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from rema_data import interrupts
from rema_data.convert.base import ExportedFile, ExportOptions, ExportPlan, ImportedBlock, Maps, Source
from rema_data.convert.layout import (
    obs_dtype,
    obs_of_scenes,
    planes_of_end_effectors,
    stored_end_effectors,
    stored_scenes,
)
from rema_data.convert.pieces import Piece, piece_bounds, read_pieces
from rema_data.convert.seal import (
    AGAIN,
    OWN,
    Header,
    SealedFolder,
    damaged,
    find_sealed,
    is_sealed,
    open_sealed,
    sealed,
)
from rema_data.errors import InputError, IntegrityError
from rema_data.grid import EE_PIXELS, SCENE_PIXELS
from rema_data.progress import Progress
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import BlockEntry, Manifest
from rema_data.schema import TASK_NUMBERS
from rema_data.storage import file_sha256, not_written
from rema_data.store.block import EPISODES, STEPS, BlockKey, BlockReader, EncodedMaps
from rema_data.store.keys import SPLITS
from rema_data.store.tables import with_column

__all__ = ["FolderFormat", "NewDataset"]

Array = npt.NDArray[Any]
Observations = tuple[Array, Array]
"""``obs_of_scenes`` and ``obs_of_end_effectors`` of some steps."""

_OBS = ((SCENE_PIXELS, SCENE_PIXELS, 1), (EE_PIXELS, EE_PIXELS, 4))


@dataclass(frozen=True, slots=True)
class NewDataset:
    """A dataset that is being written."""

    folder: Path
    release: ReleaseFolder
    blocks: tuple[BlockEntry, ...]  # in the order of their episodes: by task, those for training first
    maps: Maps
    progress: Progress

    @property
    def task(self) -> str:
        """The task, where there is one dataset a task."""
        return self.blocks[0].task

    def pieces(self, block: BlockEntry) -> Iterator[Piece]:
        """Pieces of a block in order; between two of them an interrupt is noticed."""
        for piece in read_pieces(self.release.block(block)):
            interrupts.check()
            yield piece
            self.progress.advance(piece.steps.num_rows)


class FolderFormat(ABC):
    """A format of sealed folders. A subclass says how a dataset is written, and how its maps are read."""

    name: ClassVar[str]
    version: ClassVar[int] = 1
    """Of the layout."""

    @abstractmethod
    def write(self, dataset: NewDataset) -> None:
        """Write a dataset into its empty folder; OSError where the disk refuses."""

    @abstractmethod
    def observations(self, dataset: SealedFolder, number: int, steps: int) -> Iterable[Observations]:
        """Maps of the steps of a block in order, some at a time; ``number`` is its position among the blocks.

        Raises IntegrityError where a file does not have the layout, and what takes more memory than ``steps`` need.
        """

    def folder(self, manifest: Manifest, task: str) -> str:
        """Name of the folder of a task of a release; blocks whose folder is the same are one dataset."""
        return task

    def check_options(self, options: ExportOptions) -> None:
        """Raise InputError where the format has no use for an option."""
        if options.next_obs:
            raise InputError(
                f"the format {self.name} has no next_obs: its readers take the next step of the episode",
                hint="leave out --next-obs",
            )

    def export(self, plan: ExportPlan, progress: Progress) -> list[ExportedFile]:
        """See ``Format``."""
        self.check_options(plan.options)
        groups: dict[str, list[BlockEntry]] = {}
        for block in plan.blocks:
            groups.setdefault(self.folder(plan.release.manifest, block.task), []).append(block)
        return [self._export(plan, name, sorted(blocks, key=_order), progress) for name, blocks in groups.items()]

    def _export(self, plan: ExportPlan, name: str, blocks: Sequence[BlockEntry], progress: Progress) -> ExportedFile:
        release, manifest = plan.release, plan.release.manifest
        header = Header(
            self.name,
            self.version,
            manifest.schema_version,
            manifest.name,
            manifest.sha256,
            tuple(block.key.path for block in blocks),
            plan.options.maps,
        )
        path = plan.target / name
        episodes, steps = (sum(getattr(block, count) for block in blocks) for count in ("episodes", "steps"))
        found = is_sealed(path, header)
        if found is not None:
            return ExportedFile(path, episodes, steps, found.total_bytes, new=False)
        progress.phase(f"export {name}", steps)
        card = {f.path: release.file(f).read_bytes() for f in manifest.files if f.block is None and release.has(f)}
        sums = {file.path: file.sha256 for file in manifest.files}
        with sealed(path, header, manifest, card) as folder:
            self.write(NewDataset(folder, release, tuple(blocks), plan.options.maps, progress))
            for block in blocks:
                target = folder / OWN / block.key.path
                target.mkdir(parents=True)
                for table in (EPISODES, STEPS):
                    shutil.copyfile(release.block(block).folder / table, target / table)
                    if file_sha256(target / table) != sums[f"{block.key.path}/{table}"]:
                        raise not_written(path, f"{table} of {block.key.path}")
            progress.phase(f"check {name}", steps)
            self._compare(SealedFolder(folder, header, manifest, 0), release, blocks, progress)
        size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
        return ExportedFile(path, episodes, steps, size, new=True)

    def _compare(
        self, dataset: SealedFolder, release: ReleaseFolder, blocks: Sequence[BlockEntry], progress: Progress
    ) -> None:
        """Read every map back as an import does; StorageError where one is not that of the release."""
        for number, block in enumerate(blocks):
            stream = _Stream(dataset, self.observations(dataset, number, block.steps))
            for piece in read_pieces(release.block(block)):
                interrupts.check()
                try:
                    scenes, end_effectors = stream.take(piece.steps.num_rows)
                except IntegrityError as error:
                    raise not_written(dataset.path, error.message) from error
                if not _are_of(piece.maps, scenes, end_effectors, dataset.header.maps):
                    raise not_written(dataset.path, f"the maps of {block.key.path}")
                progress.advance(piece.steps.num_rows)

    @contextmanager
    def read(self, sources: Sequence[Path], progress: Progress) -> Iterator[Source]:
        """See ``Format``."""
        folders = find_sealed(sources, self.name)
        yield _FolderSource(self, [open_sealed(folder, self.name, self.version) for folder in folders])


def _order(block: BlockEntry) -> tuple[int, int, int]:
    return TASK_NUMBERS[block.task], SPLITS.index(block.split), block.round


def _are_of(maps: EncodedMaps, scenes: Array, end_effectors: Array, chosen: Maps) -> bool:
    """Whether observations have the bits of stored maps; an end effector that steps share is decoded once."""
    wanted = planes_of_end_effectors(maps.ee_depth, maps.ee_mask, chosen)
    if end_effectors.flags.c_contiguous:  # arrays are compared fast where both lie in memory in the same way
        wanted = np.ascontiguousarray(np.moveaxis(wanted, 1, -1))
    else:
        wanted = np.moveaxis(wanted, 1, -1)
    return np.array_equal(scenes, obs_of_scenes(maps.scene, chosen)) and all(
        np.array_equal(found, wanted[row]) for found, row in zip(end_effectors, maps.ee_row, strict=True)
    )


class _FolderSource:
    """The datasets of one export."""

    def __init__(self, format: FolderFormat, datasets: Sequence[SealedFolder]) -> None:
        first = datasets[0]
        owners: dict[BlockKey, Path] = {}
        for dataset in datasets:
            if dataset.manifest.sha256 != first.manifest.sha256:
                one, other = (f"{d.header.release} {d.manifest.sha256[:12]}" for d in (first, dataset))
                raise InputError(
                    f"{first.path} belongs to the release {one}, {dataset.path} to {other}",
                    hint="import one release at a time",
                )
            for key in dataset.blocks:
                if key in owners:
                    raise InputError(
                        f"{owners[key]} and {dataset.path} both hold {key.path}", hint="name one of the folders"
                    )
                owners[key] = dataset.path
        self._format = format
        self._datasets = datasets
        self.manifest: Manifest = first.manifest
        self.card: dict[str, bytes] = first.card
        entries = {block.key: block for block in self.manifest.blocks}
        self.steps = sum(entries[key].steps for key in owners)
        self._entries = entries

    def blocks(self) -> Iterator[ImportedBlock]:
        """See ``Source``."""
        for dataset in self._datasets:
            for number, key in enumerate(dataset.blocks):
                yield ImportedBlock(key, self._pieces(dataset, number, key))

    def notes(self) -> list[str]:
        """See ``Source``."""
        return []

    def _pieces(self, dataset: SealedFolder, number: int, key: BlockKey) -> Iterator[Piece]:
        folder, entry = dataset.path / OWN / key.path, self._entries[key]
        reader = BlockReader(folder, lambda _: AGAIN, entry.episodes, entry.steps)
        episodes, steps = reader.episodes(), reader.steps()
        counts = episodes["steps"].to_numpy().astype(np.int64)
        first = np.cumsum(counts) - counts
        if (
            (counts < 1).any()
            or counts.sum() != steps.num_rows
            or not np.array_equal(episodes["first_step"].to_numpy(), first)
        ):
            raise damaged(folder / STEPS, f"it has {steps.num_rows} steps, and the episodes {counts.sum()}")
        stream = _Stream(dataset, self._format.observations(dataset, number, steps.num_rows))
        for start, stop, begin, end in piece_bounds(counts):
            scenes, end_effectors = stream.take(end - begin)
            try:
                scene = stored_scenes(scenes)
                depth, mask = stored_end_effectors(end_effectors)
            except InputError as error:
                raise damaged(dataset.path, f"a map of {key.path} cannot be stored: {error.message}") from error
            yield Piece(
                with_column(episodes.slice(start, stop - start), "first_step", first[start:stop] - begin),
                steps.slice(begin, end - begin),
                EncodedMaps(scene, np.arange(end - begin, dtype=np.int32), depth, mask),
            )
        stream.end()


class _Stream:
    """Observations that come some at a time, taken as many at a time as are wanted."""

    def __init__(self, dataset: SealedFolder, batches: Iterable[Observations]) -> None:
        self._path = dataset.path
        self._dtype = obs_dtype(dataset.header.maps)
        self._batches = iter(batches)
        self._rest: Observations = tuple(np.empty((0, *shape), self._dtype) for shape in _OBS)  # type: ignore[assignment]

    def take(self, count: int) -> Observations:
        """The next observations."""
        taken = [self._rest] if len(self._rest[0]) else []
        while sum(len(scenes) for scenes, _ in taken) < count:
            taken.append(self._next())
        first, *others = taken or [self._rest]
        scenes, end_effectors = first if not others else (np.concatenate(arrays) for arrays in zip(*taken, strict=True))
        self._rest = scenes[count:], end_effectors[count:]
        return scenes[:count], end_effectors[:count]

    def end(self) -> None:
        """Raise IntegrityError where there are more."""
        if len(self._rest[0]) or next(self._batches, None) is not None:
            raise damaged(self._path, "it has more maps than steps")

    def _next(self) -> Observations:
        found = next(self._batches, None)
        if found is None:
            raise damaged(self._path, "it has fewer maps than steps")
        for array, shape in zip(found, _OBS, strict=True):
            if array.shape != (len(found[0]), *shape) or array.dtype != self._dtype:
                raise damaged(self._path, f"it has maps of {array.dtype} {array.shape[1:]}, not {self._dtype} {shape}")
        return found
