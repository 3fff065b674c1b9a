"""Answers of a policy: a valid grid index, or the reason why it is missing.

A fault is data, not an exception: the episode counts as failed and stays in the denominator.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from evaluator.policy.output import printable
from rema_data import grid

__all__ = ["Answer", "FaultReason", "PolicyFault", "check_answer", "check_maps", "form_fault", "reported_fault"]

_BOUNDS = (grid.SCENE_PIXELS, grid.SCENE_PIXELS, grid.ANGLES)


class FaultReason(StrEnum):
    """Why a policy gave no action for an episode."""

    EXCEPTION = "exception"  # act() raised
    TIMEOUT = "timeout"  # no answer before the deadline: the process was killed
    DIED = "died"  # the process ended
    RESTART = "restart"  # the process could not be started again after a death
    SHAPE = "wrong_shape"  # neither (N, 3) nor (N,)
    DTYPE = "wrong_dtype"  # not integers
    NAN = "nan"  # not even numbers
    RANGE = "out_of_range"  # outside the 64 x 64 x 16 grid
    INVALID = "invalid_action"  # on the grid, but not in `valid`
    PROTOCOL = "protocol"  # bytes that are not a reply to the question


@dataclass(frozen=True, slots=True)
class PolicyFault:
    """No action for one episode."""

    reason: str  # one of ``FaultReason``
    detail: str  # what was answered, or where it was raised


Answer = int | PolicyFault


def check_answer(answer: npt.NDArray[np.generic], valid: npt.NDArray[np.bool_]) -> list[Answer]:
    """Grid indices of what a policy returned, or a fault for every episode whose action cannot be used.

    ``valid`` is bool (N, 64, 64, 16). A wrong shape or type is a fault of all observations.
    """
    if fault := form_fault(answer, len(valid)):
        return [fault] * len(valid)
    if answer.dtype.kind not in "iu":
        return [_wrong_number(row, answer.dtype) for row in answer]
    if answer.ndim == 1:
        return [_check_index(int(index), valid[n]) for n, index in enumerate(answer)]
    return [_check_cell((int(row[0]), int(row[1]), int(row[2])), valid[n]) for n, row in enumerate(answer)]


def form_fault(answer: npt.NDArray[np.generic], count: int) -> PolicyFault | None:
    """Why an answer to ``count`` observations cannot even be sent: its shape, or entries that are not numbers."""
    if answer.shape not in ((count, 3), (count,)):
        detail = f"returned shape {answer.shape}, expected ({count}, 3) or ({count},)"
        return PolicyFault(FaultReason.SHAPE, detail)
    if answer.dtype.kind not in "biuf" or answer.dtype.itemsize > 8:
        return PolicyFault(FaultReason.DTYPE, f"returned dtype {answer.dtype}, expected integers")
    return None


def check_maps(maps: npt.NDArray[np.generic], count: int) -> npt.NDArray[np.float32] | PolicyFault:
    """Scores that a policy returned as float32 (count, 64, 64, K), or why they cannot be used."""
    if maps.ndim != 4 or maps.shape[:3] != (count, *_BOUNDS[:2]) or not 1 <= maps.shape[3] <= grid.ANGLES:
        expected = (count, *_BOUNDS)
        return PolicyFault(FaultReason.SHAPE, f"maps has shape {maps.shape}, expected {expected} or fewer angles")
    if maps.dtype.kind != "f":
        return PolicyFault(FaultReason.DTYPE, f"maps has dtype {maps.dtype}, expected floating point")
    return maps.astype(np.float32)


def _wrong_number(row: npt.NDArray[np.generic], dtype: np.dtype[np.generic]) -> PolicyFault:
    if dtype.kind == "f" and not np.isfinite(row).all():
        return PolicyFault(FaultReason.NAN, f"returned {np.asarray(row).tolist()}")
    return PolicyFault(FaultReason.DTYPE, f"returned dtype {dtype}, expected integers")


def _check_index(index: int, valid: npt.NDArray[np.bool_]) -> Answer:
    if not 0 <= index < grid.ACTIONS:
        return PolicyFault(FaultReason.RANGE, f"grid index {index} is not in 0..{grid.ACTIONS - 1}")
    i, j, k = (int(part) for part in grid.decode(index))
    return _check_cell((i, j, k), valid)


def _check_cell(cell: tuple[int, int, int], valid: npt.NDArray[np.bool_]) -> Answer:
    if any(not 0 <= part < bound for part, bound in zip(cell, _BOUNDS, strict=True)):
        return PolicyFault(FaultReason.RANGE, f"action (i, j, k) = {cell} is not on the 64 x 64 x 16 grid")
    if not valid[cell]:
        return PolicyFault(FaultReason.INVALID, f"action (i, j, k) = {cell} is not in `valid`")
    return int(grid.encode(*cell))


def reported_fault(header: dict[str, Any]) -> PolicyFault:
    """The fault that a policy's process reports of itself; no value in the header is trusted to have its type."""
    known = (FaultReason.EXCEPTION, FaultReason.SHAPE, FaultReason.DTYPE)
    reason = header.get("reason")
    where = header.get("where")
    detail = printable(header.get("message", "")) + (f" ({printable(where)})" if where else "")
    return PolicyFault(FaultReason(reason) if reason in known else FaultReason.PROTOCOL, detail)
