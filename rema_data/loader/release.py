"""A release as a user opens it: tables, episodes, and datasets for training."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, SupportsIndex

import numpy as np
import numpy.typing as npt

from rema_data.errors import InputError, MissingFileError
from rema_data.loader.build import decode_to_memory, open_cache
from rema_data.loader.cache import DecodedCache
from rema_data.progress import Progress
from rema_data.release.folder import ReleaseFolder, find_release
from rema_data.release.manifest import BlockEntry, Manifest
from rema_data.storage import absolute

if TYPE_CHECKING:
    import pandas as pd

    from rema_data.loader.dataset import Delivery, StepDataset
    from rema_data.schema import Episode
    from rema_data.store.block import BlockKey

__all__ = ["Release", "Which", "load"]

Which = Literal["last", "all", "picks"]


class Release:
    """A release on this machine; ``load`` makes one.

    Opening reads the manifest only. The blocks are decoded when something of them is first asked for, once per machine.
    """

    def __init__(
        self,
        folder: ReleaseFolder,
        cache: str | os.PathLike[str] | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.folder = folder
        self._cache_option: Path | Literal["memory"] | None = None
        if cache is not None:
            self._cache_option = "memory" if cache == "memory" else absolute(cache)
        self._progress = progress
        self._tables: tuple[BlockKey, Any, Any] | None = None

    @property
    def manifest(self) -> Manifest:
        """What the release is."""
        return self.folder.manifest

    @property
    def name(self) -> str:
        """Its name."""
        return self.manifest.name

    @property
    def fingerprint(self) -> str:
        """Its identity: the sha256 of the manifest."""
        return self.manifest.sha256

    @cached_property
    def blocks(self) -> tuple[BlockEntry, ...]:
        """The blocks that were on this machine when they were first asked for."""
        return self.folder.blocks()

    @cached_property
    def cache(self) -> DecodedCache:
        """The decoded blocks; built at the first use.

        Raises
        ------
        StorageError
            The cache folder cannot be written, or is full.
        IntegrityError, MissingFileError
            A file of the release is damaged or missing.
        """
        if isinstance(self._cache_option, str):
            return decode_to_memory(self.folder, self.blocks, self._progress)
        return open_cache(self.folder, self.blocks, self._cache_option, self._progress)

    def steps(
        self,
        tasks: Iterable[str] | None = None,
        split: str | Iterable[str] | None = None,
        rounds: Iterable[int] | SupportsIndex | None = None,
        skills: Iterable[str] | None = None,
        which: Which = "last",
        maps: Delivery = "quantised",
        subset: str | None = None,
        where: str | None = None,
    ) -> StepDataset:
        """A dataset of steps, for torch and as numpy arrays.

        Parameters
        ----------
        tasks : iterable of str, optional
            By default all tasks of the release, whether they are on this machine or not.
        split : str or iterable of str, optional
            ``train`` or ``val``; by default both.
        rounds : int or iterable of int, optional
            Collection rounds; by default all.
        skills : iterable of str, optional
            Keep the steps of these skills only (column ``skill``).
        which : "last", "all" or "picks"
            The last step of every episode that reached it, whose success is the task's; every executed step; or the
            steps before the last, which pick up a tool.
        maps : "quantised" or "float32"
            What a batch holds: a ``StepBatch`` or a ``FloatBatch``.
        subset : str, optional
            A fixed part of the training episodes of every block, such as ``10pct-r1``: the first of ten replicates of
            10 %, which share no episode. ``1pct-r1`` is a part of it. Validation episodes stay as they are.
        where : str, optional
            Keep the steps that meet a condition, ``"target_shape = 'T' and lift_m < 0.1"``: an SQL expression over all
            columns of ``rema_data.query.COLUMNS``. It needs DuckDB, the extra ``query``. The dataset is that of
            ``select`` with the steps that the condition gives, whatever its text.

        Raises
        ------
        InputError
            The release has no such task, round, split, skill or subset, or no such step; the condition names an unknown
            column, compares what does not fit, or cannot be read.
        MissingFileError
            A block of the selection is not on this machine; the command that fetches it is in the message.
        StorageError, IntegrityError
            As for ``cache``; the rows of the subset are not those of its manifest.

        Examples
        --------
        >>> import rema_data
        >>> release = rema_data.load("rema-sample")
        >>> picks = release.steps(tasks=["grasp_push"], split="train", which="picks")
        >>> set(picks.table["step"]), set(picks.table["skill"])
        ({0}, {'grasp'})
        >>> picks[:2].float().end_effector.shape
        torch.Size([2, 4, 112, 112])
        """
        if which not in ("last", "all", "picks"):
            raise InputError(f"which={which!r} names no steps", hint="use which='last', 'all' or 'picks'")
        chosen = self.manifest.select(tasks, rounds, split)
        self._require(chosen)
        from rema_data.loader.dataset import StepDataset, identity

        wanted = {block.key for block in chosen}
        index = self.cache.index
        keep = np.concatenate([np.full(block.steps, block.key in wanted) for block in self.blocks])
        if which != "all":
            keep &= index["last"] == (which == "last")
        named = None if skills is None else sorted({skills} if isinstance(skills, str) else set(skills))
        if named is not None:
            keep &= np.isin(index["skill"], self._skill_codes(named))
        if subset is not None:
            from rema_data.loader.subsets import steps_in_subset

            keep &= steps_in_subset(self, subset, wanted)
        selected = np.flatnonzero(keep)
        if not len(selected):
            raise InputError(
                f"release {self.name} has no step of this selection", hint="choose other tasks, skills or steps"
            )
        selection: dict[str, object] = {"blocks": sorted(key.path for key in wanted), "skills": named, "which": which}
        if subset is not None:
            selection["subset"] = subset
        dataset = StepDataset(self.cache, selected, identity(self.fingerprint, selection), maps)
        if where is None:
            return dataset
        from rema_data.loader.conditions import steps_where

        met = steps_where(self, where, wanted)[selected]
        if not met.any():
            raise InputError(
                f"release {self.name} has no step of this selection where {where}",
                hint="choose another condition, or other tasks, skills or steps",
                where=where,
            )
        return dataset.select(met)

    def _require(self, chosen: Sequence[BlockEntry]) -> None:
        """Raise MissingFileError where blocks are not on this machine, or were not when this release was opened."""
        self.folder.require(chosen)
        late = [block.key.path for block in chosen if block not in self.blocks]
        if late:
            raise MissingFileError(
                f"release {self.name} was opened before {', '.join(late)} came to this machine",
                hint=f"open it again: rema_data.load({self.name!r})",
                blocks=late,
            )

    def _skill_codes(self, names: list[str]) -> list[int]:
        has = list(self.cache.categories["skill"])
        unknown = [name for name in names if name not in has]
        if unknown:
            raise InputError(
                f"release {self.name} has no step of the skill {', '.join(unknown)}",
                hint=f"it has: {', '.join(sorted(has))}",
            )
        return [has.index(name) for name in names]

    @cached_property
    def episodes(self) -> pd.DataFrame:
        """One row an episode of the local blocks; columns as in ``rema_data.store.columns.EPISODE_COLUMNS``."""
        return _joined([self.folder.block(block).episodes() for block in self.blocks])

    def to_pandas(self) -> pd.DataFrame:
        """One row an executed step of the local blocks; columns as in ``rema_data.store.columns.STEP_COLUMNS``."""
        return _joined([self.folder.block(block).steps() for block in self.blocks])

    def episode(self, round: int, task: str, split: str, index: int) -> Episode:
        """One episode, with what was observed.

        Raises
        ------
        InputError
            There is no such episode.
        MissingFileError
            Its block is not on this machine.
        """
        (block,) = self.manifest.select([task], [round], split)
        self._require([block])
        from rema_data.loader.episodes import read_episode

        if self._tables is None or self._tables[0] != block.key:
            reader = self.folder.block(block)
            self._tables = (block.key, reader.episodes(), reader.steps())
        _, episodes, steps = self._tables
        numbers = episodes["episode"].to_pylist()
        if index not in numbers:  # of an import from which some were deleted there are gaps
            raise InputError(
                f"block {block.key.path} has no episode {index}",
                hint=f"its episodes are {len(numbers):,} of 0 to {numbers[-1]}",
                episode=index,
            )
        first = sum(other.steps for other in self.blocks[: self.blocks.index(block)])
        return read_episode(episodes, steps, numbers.index(index), self.cache, first)

    def iter_episodes(
        self,
        tasks: Iterable[str] | None = None,
        split: str | Iterable[str] | None = None,
        rounds: Iterable[int] | SupportsIndex | None = None,
        where: str | None = None,
    ) -> Iterator[Episode]:
        """Episodes one after the other, with what was observed: frozen records, their steps in order.

        They come in the order of the blocks (round, task, split), and within a block in that of their numbers. One
        block's tables are in memory at a time, and observations are copied from the decoded cache.

        Parameters
        ----------
        tasks, split, rounds
            As for ``steps``.
        where : str, optional
            Keep the episodes of which at least one executed step meets a condition; see ``steps``. Such an episode
            comes whole. For example ``"episode_success"``, or ``"last and lift_m > 0.2"``.

        Raises
        ------
        InputError, MissingFileError, StorageError, IntegrityError
            As for ``steps``, before the first episode. A selection without episodes is empty.
        """
        chosen = self.manifest.select(tasks, rounds, split)
        self._require(chosen)
        keys = {block.key for block in chosen}
        met = None
        if where is not None:
            from rema_data.loader.conditions import steps_where

            met = steps_where(self, where, keys)
        return self._iterate(keys, met)

    def _iterate(self, keys: set[BlockKey], met: npt.NDArray[np.bool_] | None) -> Iterator[Episode]:
        from rema_data.loader.episodes import read_episodes

        first = 0
        for block in self.blocks:
            if block.key in keys:
                chosen = None if met is None else met[first : first + block.steps]
                if chosen is None or chosen.any():
                    reader = self.folder.block(block)
                    yield from read_episodes(reader.episodes(), reader.steps(), self.cache, first, chosen)
            first += block.steps

    def __repr__(self) -> str:
        counts = self.manifest.counts
        return f"<Release {self.name}: {counts['episodes']:,} episodes, {counts['steps']:,} steps>"


def _joined(tables: list[Any]) -> pd.DataFrame:
    import pyarrow as pa

    frame: pd.DataFrame = pa.concat_tables(tables).to_pandas()
    return frame


def load(
    name_or_path: str | os.PathLike[str] | None = None,
    *,
    cache: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Release:
    """Open a release that is on this machine.

    Parameters
    ----------
    name_or_path : str or path, optional
        Name of a published release, or the folder of any; by default the newest published one that is here.
    cache : path or "memory", optional
        Folder of decoded caches, by default ``REMA_HOME/decoded``; or "memory", to decode into the memory of this
        process.
    progress : rema_data.progress.Progress, optional
        Gets the number of decoded bytes.

    Raises
    ------
    InputError
        There is no release of that name.
    MissingFileError
        It is not on this machine, or the folder is not that of a release.
    IntegrityError
        Its manifest is damaged, or not the published one.

    Examples
    --------
    >>> import rema_data
    >>> release = rema_data.load("rema-sample")
    >>> dataset = release.steps(tasks=["grasp"], split="train")
    >>> dataset[:8].scene.shape
    torch.Size([8, 64, 64])
    """
    return Release(find_release(name_or_path), cache, progress)
