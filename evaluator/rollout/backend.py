"""The world and the host of policies, as one record that tests replace."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from evaluator.engines import FINGERPRINT, SIMULATOR
from evaluator.run.environment import source_digest
from evaluator.sim.bullet import require_bullet
from rema_data.errors import RunMismatchError
from rema_data.schema import Observation, Situation

if TYPE_CHECKING:
    from evaluator.policy import Answer, ObservationBatch, PolicySpec

__all__ = ["Backend", "PolicyProcess", "check_digest", "default_backend"]


class PolicyProcess(Protocol):
    """What a run needs of ``evaluator.policy.PolicyHost``: situations are for privileged policies only."""

    @property
    def privileged(self) -> bool: ...

    def act(self, batch: ObservationBatch, situations: tuple[Situation, ...] | None) -> list[Answer]: ...


def _as_it_will_be(policy: PolicySpec, checkpoint: Path | None, run: Path) -> AbstractContextManager[PolicySpec]:
    """No copy: every process takes its own."""
    return nullcontext(policy)


@dataclass(frozen=True, slots=True)
class Backend:
    """The world and the policies of a run."""

    observe: Callable[[Situation], Observation]
    valid_actions: Callable[[str, int], npt.NDArray[np.bool_]]  # (task, step) to bool (64, 64, 16)
    observation_hash: str  # identity of everything that ``observe`` depends on
    simulator: str  # ``module:attribute`` of the simulator's factory
    # ``module:attribute`` of the function that gives it, called in a child process: this one loads no physics
    fingerprint: str
    protocol_hash: Callable[[str, str], str]  # (task, protocol name) to sha256
    policy_digest: Callable[[PolicySpec, Path | None], str]
    # (policy, checkpoint, device, log file, sandbox command or None) to the policy's process
    open_policy: Callable[[PolicySpec, Path | None, str, Path, str | None], AbstractContextManager[PolicyProcess]]
    # (policy, checkpoint, folder of the run) to the policy as it is now, for all processes of the run
    hold_policy: Callable[[PolicySpec, Path | None, Path], AbstractContextManager[PolicySpec]] = _as_it_will_be


def check_digest(policy: PolicyProcess, name: str, recorded: str) -> None:
    """Raise RunMismatchError where what runs is not the policy whose digest was ``recorded``: a file was changed."""
    if getattr(policy, "digest", recorded) != recorded:
        raise RunMismatchError(
            f"policy {name} is not the one that was recorded: its code or its weights changed",
            hint="leave its folder and its weights alone while it is in use; to use what is there now, begin in a new "
            "folder (--output)",
            policy=name,
        )


def default_backend() -> Backend:
    """The real world and the real host; raises InputError where PyBullet is not installed."""
    require_bullet()
    from evaluator.policy import PolicyHost, digest
    from evaluator.policy.sandbox.private_copy import held
    from evaluator.protocol import protocol_hash
    from evaluator.sim import DECIDES
    from evaluator.sim.observation import observe
    from evaluator.sim.parameters import parameters_hash
    from evaluator.sim.reach import valid_actions

    def open_policy(
        policy: PolicySpec, checkpoint: Path | None, device: str, log: Path, sandbox: str | None
    ) -> PolicyHost:
        return PolicyHost(policy, checkpoint, device, log=log, sandbox=sandbox)

    return Backend(
        observe=observe,
        valid_actions=valid_actions,
        observation_hash=f"{parameters_hash()} {source_digest(*DECIDES)}",
        simulator=SIMULATOR,
        fingerprint=FINGERPRINT,
        protocol_hash=protocol_hash,
        policy_digest=digest,
        open_policy=open_policy,
        hold_policy=held,
    )
