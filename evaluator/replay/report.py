"""The findings of a replay, and the signature of a run that passed."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evaluator.run.check import Finding
from evaluator.run.header import RUN_FILE
from evaluator.run.signature import SIGNATURE_FILE
from rema_data.errors import InputError, IntegrityError, RunMismatchError
from rema_data.storage import write_atomic

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

__all__ = ["ReplayReport", "sign"]


@dataclass(frozen=True, slots=True)
class ReplayReport:
    """What a replay found."""

    run: str
    policy: str
    task: str
    protocol: str
    merkle_root: str  # over the rows of the results table; hexadecimal
    run_sha256: str  # of ``run.json``; hexadecimal
    episodes: int
    unfinished: int  # episodes without a result because the run was interrupted
    infra_errors: int  # episodes lost to the infrastructure
    fraction: float  # share of the measured episodes to simulate again
    seed: int | None  # with which they were drawn; None where all or none were
    replayed: int  # episodes simulated again
    lost: int  # those that could not be simulated here
    # (recorded, here) of the simulator: rows may then differ, which is not a finding
    differences: dict[str, tuple[Any, Any]]
    different_rows: int  # replayed rows of which any recorded value differed
    # Clopper-Pearson, among all measured rows: the upper end bounds the share of false rows
    different_ci95: tuple[float, float]
    flips: int  # replayed rows with another success or another label
    flips_ci95: tuple[float, float]
    signed: bool
    signer: str | None  # name of the public key with which the signature was checked
    audit: dict[str, Any] | None  # what the run says about its own repeats
    findings: tuple[Finding, ...]  # empty where everything is as it was sealed, and true

    @property
    def ok(self) -> bool:
        """Whether nothing was found."""
        return not self.findings

    @property
    def same_simulator(self) -> bool:
        """Whether the simulator here is that of the run, so that every bit must be the same."""
        return not self.differences

    def to_dict(self) -> dict[str, Any]:
        """The report, ready for JSON."""
        return {"ok": self.ok, "same_simulator": self.same_simulator, **asdict(self)}


def sign(folder: Path, report: ReplayReport, key: Ed25519PrivateKey) -> Path:
    """Sign ``run.json`` after a replay found nothing; the path of the signature.

    Raises InputError where nothing was simulated again or the run is not finished, IntegrityError where the replay
    found something or ``run.json`` has changed since, RunMismatchError where the replay had another simulator.
    """
    if not report.ok:
        raise IntegrityError(f"{folder} is not signed: the replay found something", hint="see the findings")
    if not report.same_simulator:
        raise RunMismatchError(
            f"{folder} is not signed: the simulator here is not that of the run",
            hint="replay it where the fingerprint is the same",
        )
    if report.unfinished:
        raise InputError(
            f"{folder} is not signed: {report.unfinished:,} of its {report.episodes:,} episodes have no result",
            hint="finish the run first: the same `rema evaluate` again continues it",
            unfinished=report.unfinished,
        )
    if not report.replayed:
        raise InputError(
            f"{folder} is not signed: none of its episodes was simulated again",
            hint="replay at least a part of it: --fraction 0.02",
        )
    payload = (folder / RUN_FILE).read_bytes()
    if hashlib.sha256(payload).hexdigest() != report.run_sha256:
        raise IntegrityError(f"{folder / RUN_FILE} changed while it was replayed", hint="replay it again")
    write_atomic(folder / SIGNATURE_FILE, key.sign(payload))
    return folder / SIGNATURE_FILE
