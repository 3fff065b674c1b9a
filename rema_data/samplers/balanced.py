"""The balanced sampler: equal shares of the labels in every batch, resumable anywhere, the same on any world size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, Literal

import numpy as np

from rema_data.errors import InputError
from rema_data.positions import Positions
from rema_data.samplers.arguments import one_of, refuse_mixed_splits, whole
from rema_data.samplers.batch_plan import BatchPlan, ExactPlan, LotteryPlan
from rema_data.samplers.epoch_state import Batch, EpochState, ResumableOrder
from rema_data.samplers.ranks import Ranks
from rema_data.samplers.report import SamplerReport, make_report
from rema_data.samplers.row_order import RowOrder, bits, shuffled, stream_key
from rema_data.samplers.shares import shares_of
from rema_data.samplers.source import source_of
from rema_data.samplers.strata import label_text, stratify

__all__ = ["BalancedSampler"]

STATE_VERSION = 1
BLOCK = 2**15
"""Draws that are prepared at a time."""
_ROWS, _SHUFFLES, _LOTTERY = range(3)  # purposes of the random streams


class BalancedSampler(ResumableOrder):
    """Batches of rows in which every stratum has its share.

    Tasks (the values of the first column of ``by``) have equal shares, or those in ``shares``; successes and failures
    (those of the second) have equal shares within each task. Every row of a stratum is drawn before any is drawn again,
    across epochs too.

    Iterating gives one epoch: lists of row numbers, for ``DataLoader(dataset, batch_sampler=sampler)``. Epochs advance
    by themselves.

    Parameters
    ----------
    table : dataset, DataFrame or mapping
        Something with a ``table``, a torch ``Subset`` of that, or the columns themselves. Row numbers are positions in
        it, and a dataset refuses those of another table.
    batch_size : int
        Rows in a batch of one rank. The global batch is ``batch_size * world_size`` rows: it is built first and then
        dealt out, so its rows do not depend on how many ranks share it.
    by : str or sequence of str
        Columns whose combinations are the strata.
    mode : {"exact", "average"}
        ``"exact"``: the count of a stratum in a global batch is its share of it, rounded up or down, and never strays
        from it by a whole draw over time. ``"average"``: every draw picks its stratum by chance, as in the paper.
    num_samples : int, optional
        Draws in an epoch, over all ranks; by default as many as the table has rows. Draws that do not fill a global
        batch are left out.
    seed : int
    rank, world_size : int, optional
        By default those of ``torch.distributed``, which has to be initialised where there are several processes.
    on_empty : {"raise", "renormalise"}
        What to do about a stratum without rows: see ``rema_data.samplers.strata.stratify``.
    rotate : bool
        Allow an exact global batch with fewer rows than strata, in which strata take turns.
    shares : mapping, optional
        Shares of some values of the first column of ``by``, as positive numbers in any unit, where they are not to be
        equal: with ``{"grasp_push": 3}`` that task is drawn three times as often as each of the others.

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
        mode: Literal["exact", "average"] = "exact",
        num_samples: int | None = None,
        seed: int = 0,
        rank: int | None = None,
        world_size: int | None = None,
        on_empty: Literal["raise", "renormalise"] = "raise",
        rotate: bool = False,
        shares: Mapping[Any, float] | None = None,
    ) -> None:
        super().__init__()
        one_of("mode", mode, ("exact", "average"))
        one_of("on_empty", on_empty, ("raise", "renormalise"))
        self.batch_size = whole("batch_size", batch_size, 1)
        self.seed = whole("seed", seed, 0)
        self._ranks = Ranks.of(rank, world_size)
        self.rank, self.world_size = self._ranks.rank, self._ranks.world_size
        self.global_batch = self.batch_size * self.world_size
        self.mode = mode
        source = source_of(table)
        refuse_mixed_splits(source.table)
        self.strata = stratify(source.table, (by,) if isinstance(by, str) else by, on_empty)
        self._identity = source.fingerprint
        draws = len(self.strata.codes) if num_samples is None else whole("num_samples", num_samples, 1)
        self._batches = draws // self.global_batch
        if not self._batches:
            raise InputError(
                f"an epoch of {draws} draws does not fill one batch of {self.global_batch}",
                hint="use a smaller batch, or a longer epoch (num_samples=...)",
                draws=draws,
            )
        self._shares = dict(shares or {})
        self._plan = self._make_plan(rotate)
        self._orders = [
            RowOrder(rows, stream_key(self.seed, _ROWS, number)) for number, rows in enumerate(self.strata.rows)
        ]

    def _make_plan(self, rotate: bool) -> BatchPlan:
        shares = shares_of(self.strata, self._shares)
        if self.mode == "average":
            return LotteryPlan(shares, self.global_batch, stream_key(self.seed, _LOTTERY))
        if self.global_batch < len(shares) and not rotate:
            raise InputError(
                f"a batch of {self.global_batch} cannot hold each of {len(shares)} strata",
                hint=f"use a batch of {len(shares)} or more, let the strata take turns with rotate=True, "
                'or balance on average with mode="average"',
                batch=self.global_batch,
                strata=len(shares),
            )
        plan = ExactPlan(shares, self.global_batch)
        for number in np.flatnonzero(plan.shares == 0)[:1]:
            raise InputError(
                f"the stratum {label_text(self.strata.by, self.strata.labels[number])} has a share of "
                f"{shares[number]:.2g}: too small for exact batches of {self.global_batch}",
                hint='use mode="average", or balance by columns of fewer values',
            )
        return plan

    def __len__(self) -> int:
        """Batches in an epoch, the same on every rank."""
        return self._batches

    def __repr__(self) -> str:
        return (
            f"BalancedSampler({len(self.strata.codes)} rows, {len(self.strata.labels)} strata of "
            f"{', '.join(self.strata.by)}, batch_size={self.batch_size}, rank {self.rank} of {self.world_size})"
        )

    drop_last = True
    """An epoch has whole batches only: what wraps a sampler of batches has nothing to fill up."""

    def _hand_out(self, batch: Batch) -> Positions:
        return Positions(batch.tolist(), self._identity, len(self.strata.codes))

    def _begin(self, beginner: EpochState) -> tuple[int, int]:
        self._ranks.check()
        return super()._begin(beginner)

    def _fetch(self, epoch: int, step: int) -> Batch:
        """Batches of this rank from ``step`` on, to the end of a block; int64 (batches, rows)."""
        stop = min(self._batches, step + max(1, BLOCK // self.global_batch))
        rows = self._global_batches(epoch * self._batches + step, epoch * self._batches + stop)
        stream = stream_key(self.seed, _SHUFFLES, epoch)
        keys = bits(stream, step * self.global_batch, rows.size).reshape(rows.shape)
        if self.world_size > 1:
            # dealt out like cards, from another rank on in every batch: every rank gets its part of every stratum
            first = (self.rank - np.arange(step, stop)) % self.world_size
            slots = first[:, None] + np.arange(0, self.global_batch, self.world_size)
            rows, keys = np.take_along_axis(rows, slots, 1), np.take_along_axis(keys, slots, 1)
        if self.mode == "exact":  # the draws of a lottery are in no order to begin with
            rows = np.take_along_axis(rows, shuffled(keys), 1)
        return rows

    def _global_batches(self, first: int, stop: int) -> Batch:
        """Batches of all ranks, counted since the start of training."""
        labels = self._plan.labels(first, stop)
        flat = labels.ravel()
        drawn = self._plan.before(first).tolist()
        counts = np.bincount(flat, minlength=len(self._orders)).tolist()
        parts = [order.draw(*place) for order, *place in zip(self._orders, drawn, counts, strict=True) if place[1]]
        rows = np.empty(len(flat), np.int64)
        rows[np.argsort(flat, kind="stable")] = np.concatenate(parts)
        return rows.reshape(labels.shape)

    @cached_property
    def fingerprint(self) -> str:
        """Identity of the data: that of the dataset, else a hash of the labels of all rows."""
        return self._identity or self.strata.fingerprint()

    @cached_property
    def _settings(self) -> dict[str, Any]:
        """Everything that decides the order, as plain values. The world size does not."""
        return {
            "by": list(self.strata.by),
            "mode": self.mode,
            "global batch": self.global_batch,
            "whole batches": self._batches,
            "seed": self.seed,
            "strata": len(self.strata.labels),
            "dataset": self.fingerprint,
            # former options: states that have them can still be loaded
            "target": "uniform" if not self._shares else sorted([str(value), n] for value, n in self._shares.items()),
            "replacement": "cycle",
            "rows of a shorter batch": 0,
        }

    def _pack(self, epoch: int, step: int) -> dict[str, Any]:
        state = {"version": STATE_VERSION, "epoch": epoch, "batch": step, "settings": dict(self._settings)}
        anchor = self._plan.anchor(epoch * self._batches + step)
        return state if anchor is None else {**state, "anchor": list(anchor)}

    def _unpack(self, state: dict[str, Any]) -> tuple[int, int]:
        hint = "pass what state_dict() of a BalancedSampler returned, or start again without it"
        if not isinstance(state, dict) or state.get("version") != STATE_VERSION:
            version = state.get("version") if isinstance(state, dict) else None
            raise InputError(f"not a state of a sampler of version {STATE_VERSION} (got {version!r})", hint=hint)
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
                "or start again without the state",
                differences={name: (here.get(name), there.get(name)) for name in names},
            )
        match state.get("epoch"), state.get("batch"), state.get("row", 0):
            case (int(epoch), int(batch), 0) if epoch >= 0 and 0 <= batch <= len(self):
                pass
            case position:
                raise InputError(f"epoch, batch, row = {position} is not a position in {len(self)} batches", hint=hint)
        if "anchor" in state:
            try:
                self._plan.restore(state["anchor"], epoch * self._batches + batch)
            except (TypeError, ValueError, IndexError) as error:
                raise InputError("the counts in the state are damaged", hint=hint) from error
        return epoch, batch

    def describe(self) -> SamplerReport:
        """What an epoch does to the data: shares and repeats of every stratum."""
        return make_report(self.strata, self._plan.shares, self._batches * self.global_batch)
