"""The balanced sampler: equal shares of the labels in every batch, resumable anywhere, the same on any world size."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from rema_data.errors import InputError
from rema_data.samplers.arguments import one_of, rank_and_world, refuse_mixed_splits, whole
from rema_data.samplers.batch_plan import ExactPlan, LotteryPlan, Plan
from rema_data.samplers.epoch_state import ResumableOrder
from rema_data.samplers.epochs import Epoch, EpochShape, Tail, cut_epoch, draws_of_epoch
from rema_data.samplers.report import SamplerReport, make_report
from rema_data.samplers.row_order import Cycle, Independent, Replacement, Walk, bits, shuffled, stream_key
from rema_data.samplers.shares import Target, target_shares
from rema_data.samplers.strata import describe_label, label_text, stratify, table_of

__all__ = ["BalancedSampler", "FlatSampler"]

Batch = npt.NDArray[np.int64]
"""Rows of the table, int64 (batch_size,)."""
STATE_VERSION = 1
BLOCK = 2**15
"""Draws that are prepared at a time."""
_WALKS, _SHUFFLES, _LOTTERY = range(3)  # purposes of the random streams


class BalancedSampler(ResumableOrder[Batch]):
    """Batches of rows in which every stratum has its share.

    Iterating gives one epoch: int64 arrays of row numbers, for ``DataLoader(dataset, batch_sampler=sampler)``. For
    ``DataLoader(dataset, sampler=..., batch_size=...)`` use ``sampler.flat()``. Epochs advance by themselves.

    Parameters
    ----------
    table : dataset, DataFrame or mapping
        Something with a ``table``, or the columns themselves. Row numbers are positions in it.
    batch_size : int
        Rows in a batch of one rank. The global batch is ``batch_size * world_size`` rows: it is built first and then
        dealt out, so its rows do not depend on how many ranks share it.
    by : str or sequence of str
        Columns whose combinations are the strata.
    target : {"uniform", "natural"}, float or mapping
        Shares of the strata: see ``rema_data.samplers.shares.target_shares``. By default tasks are equal, and successes
        and failures are equal within each task.
    mode : {"exact", "average"}
        ``"exact"``: the count of a stratum in a global batch is its share of it, rounded up or down, and never strays
        from it by a whole draw over time. ``"average"``: every draw picks its stratum by chance, as in the paper.
    replacement : {"cycle", True, False}
        ``"cycle"``: every row of a stratum is drawn before any is drawn again, and this goes on across epochs. True:
        any row at any time. False: no row twice in an epoch, and every epoch starts afresh (``mode="exact"`` only).
    epoch : {"rows", "minority_once", "majority_once"} or int
        Draws in an epoch, over all ranks: as many as the table has rows; as many as use up the scarcest stratum, or
        the last one, once; or a number.
    num_samples : int, optional
        The same as a number for ``epoch``.
    seed : int
    rank, world_size : int, optional
        By default those of ``torch.distributed`` where it is initialised, else 0 and 1.
    tail : {"drop", "pad", "short"}
        What to do about draws of an epoch that do not fill a global batch: leave them, fill the batch up with more
        draws, or make one shorter batch.
    on_empty : {"raise", "renormalise"}
        What to do about a stratum without rows: see ``rema_data.samplers.strata.stratify``.
    rotate : bool
        Allow an exact global batch with fewer rows than strata, in which strata take turns.
    across_splits : bool
        Allow a table with rows of more than one ``split``.

    Raises
    ------
    InputError
        An argument cannot be used, or the table cannot give what is asked for.

    Examples
    --------
    >>> table = {"task": ["push"] * 6, "success": [True, False, False, False, False, False]}
    >>> sampler = BalancedSampler(table, batch_size=2)
    >>> len(sampler), all(0 in batch for batch in sampler)
    (3, True)
    """

    def __init__(
        self,
        table: Any,
        batch_size: int = 8,
        *,
        by: str | Sequence[str] = ("task", "success"),
        target: Target = "uniform",
        mode: Literal["exact", "average"] = "exact",
        replacement: Replacement = "cycle",
        epoch: Epoch = "rows",
        num_samples: int | None = None,
        seed: int = 0,
        rank: int | None = None,
        world_size: int | None = None,
        tail: Tail = "drop",
        on_empty: Literal["raise", "renormalise"] = "raise",
        rotate: bool = False,
        across_splits: bool = False,
    ) -> None:
        super().__init__()
        one_of("mode", mode, ("exact", "average"))
        one_of("replacement", replacement, ("cycle", True, False))
        one_of("tail", tail, ("drop", "pad", "short"))
        one_of("on_empty", on_empty, ("raise", "renormalise"))
        self.batch_size = whole("batch_size", batch_size, 1)
        self.seed = whole("seed", seed, 0)
        self.rank, self.world_size = rank_and_world(rank, world_size)
        self.global_batch = self.batch_size * self.world_size
        self.mode, self.replacement, self.tail = mode, replacement, tail
        columns = table_of(table)
        if not across_splits:
            refuse_mixed_splits(columns)
        self.strata = stratify(columns, (by,) if isinstance(by, str) else by, on_empty)
        self._identity = getattr(table, "fingerprint", None)
        self._target = target
        shares = target_shares(self.strata, target)
        self._check_request(rotate)
        if num_samples is not None:
            if epoch != "rows":
                raise InputError("epoch and num_samples are both given", hint="give one of them")
            epoch = num_samples
        self.shape, self._plan = self._lay_out(shares, epoch)
        walk: type[Independent] | type[Cycle] = Independent if replacement is True else Cycle
        self._walks: list[Walk] = [
            walk(rows, stream_key(self.seed, _WALKS, number)) for number, rows in enumerate(self.strata.rows)
        ]

    def _check_request(self, rotate: bool) -> None:
        strata = len(self.strata.labels)
        if self.mode == "exact" and self.global_batch < strata and not rotate:
            raise InputError(
                f"a batch of {self.global_batch} cannot hold each of {strata} strata",
                hint=f"use a batch of {strata} or more, let the strata take turns with rotate=True, "
                'or balance on average with mode="average"',
                batch=self.global_batch,
                strata=strata,
            )
        if self.mode == "average" and self.replacement is False:
            raise InputError(
                'replacement=False needs mode="exact": chance may ask a stratum for more rows than it has',
                hint='use replacement="cycle", or mode="exact"',
            )

    def _lay_out(self, shares: npt.NDArray[np.float64], epoch: Epoch) -> tuple[EpochShape, Plan]:
        """How long an epoch is, and the plan of its batches."""
        draws = draws_of_epoch(epoch, self.strata.sizes, shares)
        while True:
            shape = cut_epoch(draws, self.global_batch, self.tail, self.world_size)
            if self.mode == "average":
                return shape, LotteryPlan(shares, shape, stream_key(self.seed, _LOTTERY))
            plan = ExactPlan(shares, shape, alike=self.replacement is False)
            for number, share in enumerate(plan.shares.tolist()):
                if share == 0:
                    raise InputError(
                        f"{describe_label(self.strata.by, self.strata.labels[number])} has a share of "
                        f"{shares[number]:.2g}: too small for exact batches of {self.global_batch}",
                        hint='use mode="average", or another target',
                    )
            if self.replacement is not False:
                return shape, plan
            missing = plan.before(0, shape.batches) - self.strata.sizes
            if missing.max() <= 0:
                return shape, plan
            if epoch != "minority_once":
                number = int(missing.argmax())
                raise InputError(
                    f"replacement=False, but an epoch draws {missing[number] + self.strata.sizes[number]} times from "
                    f"{describe_label(self.strata.by, self.strata.labels[number])}, which has "
                    f"{self.strata.sizes[number]} rows",
                    hint='use epoch="minority_once", fewer num_samples, or replacement="cycle"',
                    strata=self.strata.labels[number],
                )
            # rounding gave the scarcest stratum a draw too many
            least = 1 if self.tail == "short" else self.global_batch
            draws = shape.draws - max(least, math.ceil(max(missing / plan.shares)))

    def __len__(self) -> int:
        """Batches in an epoch, the same on every rank."""
        return self.shape.batches

    def __repr__(self) -> str:
        return (
            f"BalancedSampler({len(self.strata.codes)} rows, {len(self.strata.labels)} strata of "
            f"{', '.join(self.strata.by)}, batch_size={self.batch_size}, rank {self.rank} of {self.world_size})"
        )

    def flat(self) -> FlatSampler:
        """The same rows one by one, for ``DataLoader(dataset, sampler=sampler.flat(), batch_size=...)``."""
        return FlatSampler(self)

    def _fetch(self, epoch: int, step: int) -> Any:
        """Batches of this rank from ``step`` on, to the end of a block; int64 (batches, rows)."""
        shape = self.shape
        short = step >= shape.whole
        stop = step + 1 if short else min(shape.whole, step + max(1, BLOCK // shape.batch))
        rows = self._global_batches(epoch, step, stop)
        size = rows.shape[1]
        keys = bits(stream_key(self.seed, _SHUFFLES, epoch), step * shape.batch, rows.size).reshape(rows.shape)
        if self.world_size > 1:
            # dealt out like cards, from another rank on in every batch: every rank gets its part of every stratum
            first = (self.rank - np.arange(step, stop)) % self.world_size
            slots = first[:, None] + np.arange(0, size, self.world_size)
            if short:
                slots = slots[:, slots[0] < size]
            rows, keys = np.take_along_axis(rows, slots, 1), np.take_along_axis(keys, slots, 1)
        if self.mode == "exact":  # the draws of a lottery are in no order to begin with
            rows = np.take_along_axis(rows, shuffled(keys), 1)
        return rows

    def _global_batches(self, epoch: int, first: int, stop: int) -> Batch:
        labels = self._plan.labels(epoch, first, stop)
        drawn = self._plan.before(epoch, first).tolist()
        flat = labels.ravel()
        counts = np.bincount(flat, minlength=len(self._walks)).tolist()
        if self.replacement is False:
            drawn = [epoch * size + count for size, count in zip(self.strata.sizes.tolist(), drawn, strict=True)]
        parts = [walk.draw(*place) for walk, *place in zip(self._walks, drawn, counts, strict=True) if place[1]]
        rows = np.empty(len(flat), np.int64)
        rows[np.argsort(flat, kind="stable")] = np.concatenate(parts)
        return rows.reshape(labels.shape)

    @property
    def fingerprint(self) -> str:
        """Identity of the data: that of the dataset, else a hash of the labels of all rows."""
        return self._identity if isinstance(self._identity, str) else self._own_fingerprint

    @cached_property
    def _own_fingerprint(self) -> str:
        return self.strata.fingerprint()

    @cached_property
    def _settings(self) -> dict[str, Any]:
        """Everything that decides about the order, as plain values. The world size does not."""
        target = self._target
        if isinstance(target, Mapping):
            shares = target_shares(self.strata, target).tolist()
            texts = [label_text(self.strata.by, label) for label in self.strata.labels]
            target = dict(zip(texts, shares, strict=True))
        return {
            "by": list(self.strata.by),
            "target": target,
            "mode": self.mode,
            "replacement": self.replacement,
            "global batch": self.global_batch,
            "whole batches": self.shape.whole,
            "rows of a shorter batch": self.shape.rest,
            "seed": self.seed,
            "strata": len(self.strata.labels),
            "dataset": self.fingerprint,
        }

    def _pack(self, epoch: int, step: int, row: int = 0) -> dict[str, Any]:
        state = {
            "version": STATE_VERSION,
            "epoch": epoch,
            "batch": step,
            "row": row,
            "world_size": self.world_size,
            "settings": dict(self._settings),
        }
        anchor = self._plan.anchor(epoch, step)
        return state if anchor is None else {**state, "anchor": list(anchor)}

    def _unpack(self, state: dict[str, Any]) -> tuple[int, int]:
        epoch, batch, row = self._position(state)
        if row:
            raise InputError(
                f"the state is in the middle of batch {batch}, at row {row}",
                hint="load it into sampler.flat(), which made it",
                row=row,
            )
        return epoch, batch

    def _position(self, state: dict[str, Any]) -> tuple[int, int, int]:
        """Epoch, batch and row of a state that belongs to this order."""
        hint = "pass what state_dict() of a BalancedSampler returned, or start anew without it"
        if not isinstance(state, dict) or state.get("version") != STATE_VERSION:
            version = state.get("version") if isinstance(state, dict) else None
            raise InputError(f"no state of a sampler of version {STATE_VERSION} (got {version!r})", hint=hint)
        there = state.get("settings")
        if not isinstance(there, dict):
            raise InputError("the state has no settings", hint=hint)
        here = self._settings
        names = [name for name in {**here, **there} if here.get(name) != there.get(name)]
        if names:
            lines = [f"  {name}: {here.get(name)!r} here, {there.get(name)!r} in the state" for name in names]
            raise InputError(
                "\n".join(["the state belongs to another order of draws:", *lines]),
                hint="make the sampler with the same data and arguments (batch_size * world_size must be equal), "
                "or start anew without the state",
                differences={name: (here.get(name), there.get(name)) for name in names},
            )
        position = tuple(state.get(name) for name in ("epoch", "batch", "row"))
        match position:
            case (int(epoch), int(batch), int(row)) if min(epoch, batch, row) >= 0 and batch + (row > 0) <= len(self):
                pass
            case _:
                raise InputError(f"epoch, batch, row = {position} is no position in {len(self)} batches", hint=hint)
        if row and state.get("world_size") != self.world_size:
            raise InputError(
                f"the state is in the middle of batch {batch}, of a world of {state.get('world_size')!r} ranks",
                hint="take the state between batches to go on with another number of ranks",
                row=row,
            )
        if "anchor" in state:
            try:
                self._plan.restore(state["anchor"], self.shape.drawn(epoch, batch))
            except (TypeError, ValueError, IndexError) as error:
                raise InputError("the counts in the state are damaged", hint=hint) from error
        return epoch, batch, row

    def describe(self, draws: int | None = None, repeat_limit: float = 20.0) -> SamplerReport:
        """What the draws will do to the data: shares and repeats of every stratum.

        Parameters
        ----------
        draws : int, optional
            Over all of training and all ranks; by default those of one epoch.
        repeat_limit : float
            Repeats of a row above which the report warns.
        """
        total = self.shape.draws if draws is None else whole("draws", draws, 0)
        return make_report(self.strata, self._plan.shares, total, repeat_limit)

    def importance_weights(self, rows: npt.ArrayLike) -> npt.NDArray[np.float32]:
        """Natural share over drawn share of the strata of some rows, float32: makes a loss unbiased again."""
        natural = self.strata.sizes / len(self.strata.codes)
        weights = (natural / self._plan.shares).astype(np.float32)
        result: npt.NDArray[np.float32] = weights[self.strata.codes[np.asarray(rows)]]
        return result


class FlatSampler(ResumableOrder[int]):
    """Rows of a ``BalancedSampler`` one by one, as Python integers.

    Batches cut from it are those of the sampler where the loader's ``batch_size`` is the sampler's. It keeps its own
    place; a state can be taken and loaded at any row (``consumed`` counts rows). A state that is taken between batches
    fits both.

    Parameters
    ----------
    batches : BalancedSampler
    """

    def __init__(self, batches: BalancedSampler) -> None:
        super().__init__()
        self._batches = batches

    def __len__(self) -> int:
        """Rows of this rank in an epoch."""
        shape = self._batches.shape
        return shape.whole * self._batches.batch_size + self._last_rows()

    def _last_rows(self) -> int:
        """Rows of this rank in the shorter batch."""
        shape, world = self._batches.shape, self._batches.world_size
        return len(range((self._batches.rank - shape.whole) % world, shape.rest, world))

    def _fetch(self, epoch: int, step: int) -> list[int]:
        batch, row = divmod(step, self._batches.batch_size)
        rows: list[int] = self._batches._fetch(epoch, batch).ravel()[row:].tolist()
        return rows

    def _pack(self, epoch: int, step: int) -> dict[str, Any]:
        if step == len(self):
            return self._batches._pack(epoch, len(self._batches))
        return self._batches._pack(epoch, *divmod(step, self._batches.batch_size))

    def _unpack(self, state: dict[str, Any]) -> tuple[int, int]:
        epoch, batch, row = self._batches._position(state)
        return epoch, min(batch * self._batches.batch_size + row, len(self))
