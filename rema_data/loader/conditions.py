"""Which steps of a decoded release meet a condition."""

from __future__ import annotations

from collections.abc import Container
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from rema_data.errors import IntegrityError
from rema_data.query import steps_that_meet
from rema_data.store.keys import BlockKey

if TYPE_CHECKING:
    from rema_data.loader.release import Release

__all__ = ["steps_where"]

_NAMES_A_STEP = ("episode", "step", "action")


def steps_where(release: Release, where: str, wanted: Container[BlockKey]) -> npt.NDArray[np.bool_]:
    """Whether local steps are of ``wanted`` blocks and meet a condition, bool (steps,).

    Raises InputError for the condition (see ``rema_data.query``), IntegrityError where the tables have changed since
    they were decoded.
    """
    index = release.cache.index
    chosen = np.concatenate([np.full(block.steps, block.key in wanted) for block in release.blocks])
    readers = [release.folder.block(block) for block in release.blocks if block.key in wanted]
    tables = [(reader.episodes(), reader.steps()) for reader in readers]
    met = steps_that_meet(where, tables)
    for name in _NAMES_A_STEP:
        if not np.array_equal(np.concatenate([steps[name].to_numpy() for _, steps in tables]), index[name][chosen]):
            raise IntegrityError(
                f"the tables of {release.name} have changed since they were decoded",
                hint=f"find all damage: {release.folder.repair.verify}",
                path=str(release.folder.path),
            )
    chosen[chosen] = met
    return chosen
