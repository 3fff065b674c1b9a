"""Self-audits: what a policy is shown where its protocol blanks a part of the maps.

The episode stays what it is, and so do the valid actions: a policy that solves it nevertheless did not need to look.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from evaluator.protocol import BLANKED
from evaluator.rollout.backend import Backend
from rema_data.schema import Observation

__all__ = ["as_shown", "showing"]

_FIELDS = {"blank-scene": ("scene",), "blank-hand": ("depth", "mask")}


def as_shown(seen: Observation, protocol: str) -> Observation:
    """An observation as a policy is shown it: zeros in place of what the protocol blanks."""
    return replace(seen, **{name: np.zeros_like(getattr(seen, name)) for name in _FIELDS.get(protocol, ())})


def showing(backend: Backend, protocol: str) -> Backend:
    """A backend for asking policies; the world of a run, in which actions are simulated, stays ``backend``."""
    if protocol not in BLANKED:
        return backend
    return replace(
        backend,
        observe=lambda situation: as_shown(backend.observe(situation), protocol),
        observation_hash=f"{backend.observation_hash} {protocol}",
    )
