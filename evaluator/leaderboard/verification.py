"""Which results the board may show: those that follow from recorded actions, as they were simulated here or by CI.

An entry holds actions and no result. A run folder holds both, and its results are believed where simulating its actions
gives the same. What was simulated on this machine is remembered (``evaluator.run.derived``); what CI simulated stands
in the verification records that come with rema.
"""

from __future__ import annotations

import dataclasses
import json
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PositiveInt

from evaluator.leaderboard.naming import name_problem
from evaluator.protocol import FLIP_LIMIT, protocol_hash
from evaluator.rollout.backend import Backend, default_backend
from evaluator.rollout.derive import derive, world_identity
from evaluator.run.derived import Derived, PackedRows, derived_of, recall, remember
from evaluator.run.entry import entry_folder
from evaluator.run.entry_fields import Fingerprint
from evaluator.run.environment import code_commit
from evaluator.run.header import Sha256
from evaluator.run.plan import find_list
from evaluator.run.reading import read_run
from evaluator.run.run import Run
from evaluator.sim.bullet import decisive
from evaluator.statistics import clopper_pearson
from rema_data.errors import InputError, IntegrityError, RemaError, RunMismatchError, SubmissionError
from rema_data.progress import Progress, Silent
from rema_data.repair import restore
from rema_data.storage import write_atomic
from rema_data.validation import record, validated

__all__ = ["Record", "known", "read_verified", "records", "verify", "write_record"]

NOT_SIMULATED = "not simulated here"
"""How the reason of a row ends that was not verified yet."""
_ROWS_NAMED = 3
_SUCCESS = "success"


@record
class Record:
    """The verification record of an entry: who reads it need not simulate the entry."""

    format: Literal[1]
    number: PositiveInt  # in which order entries were recorded: of two with the same actions, the earlier one counts
    entry: Sha256
    commit: Annotated[str, Field(pattern="^[0-9a-f]{40}$")] | None  # of the code that simulated it
    fingerprint: Fingerprint
    rows: PackedRows


def records() -> dict[str, Record]:
    """The records that come with this installation, by the sha256 of their entry."""
    folder = entry_folder() / "verified"
    found = [_read_record(path, path.stat().st_mtime_ns) for path in sorted(folder.glob("*.json"))]
    return {one.entry: one for one in found}


@lru_cache(maxsize=512)
def _read_record(path: Path, _changed: int) -> Record:
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise IntegrityError(f"{path} cannot be read: {error}", hint=restore(path), path=str(path)) from error
    return validated(Record, content, f"verification record {path}", hint=restore(path), error=IntegrityError)


def known(run: Run, backend: Backend | None = None) -> Run:
    """The run with what is known about its results, without simulating anything.

    Raises IntegrityError where its recorded results are not what its actions give.
    """
    if run.kind == "entry" and run.recorded is None:
        return run  # of format 1: it cannot be verified
    if run.kind == "entry" and (one := records().get(run.digest)) is not None:
        try:
            return run.derived(Derived.unpack(one.rows, len(run.actions), run.steps, one.fingerprint), "record")
        except ValueError as error:
            raise IntegrityError(
                f"the verification record of {run.source} is refused: {error}", hint=restore(run.source)
            ) from error
    found = _recalled(run, backend)
    return run if found is None else _with(run, found)


def _recalled(run: Run, backend: Backend | None) -> Derived | None:
    if not run.has_actions:
        return None
    try:
        world = world_identity(backend or default_backend())
    except InputError:  # there is no simulator here
        return None
    return recall(world, run.comparable, run.actions, run.steps)


def verify(
    run: Run,
    progress: Progress | None = None,
    *,
    backend: Backend | None = None,
    engine: str = "process",
    workers: int | None = None,
    again: bool = False,
) -> Run:
    """The run with results that were simulated: what is not known yet is simulated now, on all cores.

    ``again``: simulate it even so. Raises IntegrityError where an action is not valid, or recorded results are not what
    the actions give; RunMismatchError where its list or its protocol is not the one here; InputError for an entry of
    format 1; InfrastructureError.
    """
    if not run.has_actions:
        raise InputError(
            f"{run.source} holds no actions, so it cannot be verified",
            hint="make an entry of its run again: rema submit RUN",
            path=str(run.source),
        )
    if not again and (done := known(run, backend)).verified:
        return done
    world = backend or default_backend()
    found = simulated(run, progress, backend=world, engine=engine, workers=workers)
    remember(world_identity(world), run.comparable, run.actions, found)
    return _with(run, found)


def simulated(
    run: Run,
    progress: Progress | None = None,
    *,
    backend: Backend | None = None,
    engine: str = "process",
    workers: int | None = None,
) -> Derived:
    """What the actions of a run or an entry give here, and now."""
    world = backend or default_backend()
    ours, theirs = world.protocol_hash(run.task, run.protocol), run.provenance.protocol_hash
    if ours != theirs:
        raise RunMismatchError(
            f"{run.source} was played by another protocol than the one here: {theirs}, here {ours}",
            hint="use the version of rema that made it",
            field="protocol_hash",
            recorded=theirs,
            here=ours,
        )
    scenarios = find_list(run.task, run.split, run.provenance.scenarios_hash, len(run.actions))
    return derive(
        scenarios,
        run.protocol,
        run.actions,
        world,
        progress or Silent(),
        source=str(run.source),
        engine=engine,
        workers=workers,
    )


def _with(run: Run, found: Derived) -> Run:
    """The run with derived results; those of a folder must be the recorded ones, or almost, on another simulator."""
    if run.kind == "entry":
        return run.derived(found, "here")
    recorded = derived_of(run.table, run.steps, run.provenance.fingerprint)
    measured = run.outcomes.eligible
    ends = [
        _SUCCESS if success else str(failure)
        for success, failure in zip(*(run.table[name].to_pylist() for name in ("success", "failure")), strict=True)
    ]
    flips = [
        row
        for row in np.flatnonzero(measured).tolist()
        if ends[row] != found.label(row) or recorded.path(row) != found.path(row)
    ]
    same = decisive(run.provenance.fingerprint) == decisive(found.fingerprint)
    if flips and same:
        named = ", ".join(
            f"{run.table['scenario'][row].as_py()} ({ends[row]}, simulated {found.label(row)})"
            for row in flips[:_ROWS_NAMED]
        )
        raise IntegrityError(
            f"{run.source} is refused: {len(flips):,} of its outcomes are not what its actions give: {named}",
            hint=f"see all of it: rema replay {run.source}",
            path=str(run.source),
            rows=flips,
        )
    bound = clopper_pearson(len(flips), int(measured.sum()))[1]
    if not same and bound > FLIP_LIMIT:
        doubt = f"{len(flips):,} of {int(measured.sum()):,} outcomes are others in the simulator here"
        return dataclasses.replace(run, doubt=f"not verified: {doubt} (up to {100 * bound:.2g} %)")
    return dataclasses.replace(run, verified="here")


def read_verified(path: Path, progress: Progress | None = None) -> Run:
    """A run, or an entry whose results are derived: from a record, from what was simulated here, or now."""
    run = read_run(path)
    return verify(run, progress) if run.recorded is not None else run


def write_record(
    run: Run, progress: Progress | None = None, *, backend: Backend | None = None, engine: str = "process"
) -> Path:
    """Simulate an entry that comes with rema, and write its verification record, ``verified/NAME.json`` beside it.

    An entry that was simulated here before, as ``rema submit`` does, is not simulated again. Raises InputError for
    anything else than such an entry, IntegrityError where its earlier record has other rows.
    """
    folder = entry_folder()
    if run.recorded is None or run.source.resolve().parent != folder.resolve():
        raise InputError(
            f"{run.source} is not an entry of format 2 in {folder}",
            hint=f"records are kept for the entries in {folder}: copy it there first",
            path=str(run.source),
        )
    if problem := name_problem(run):
        raise SubmissionError(f"{run.source} is refused: {problem}", hint="choose another name", path=str(run.source))
    found = _recalled(run, backend) or simulated(run, progress, backend=backend, engine=engine)
    earlier, path = records(), folder / "verified" / run.source.name
    kept = earlier.get(run.digest)
    if (
        kept is not None
        and decisive(kept.fingerprint) == decisive(found.fingerprint)
        and kept.rows.sha256 != found.sha256
    ):
        raise IntegrityError(
            f"{path} has other rows than {run.source} gives: sha256 {kept.rows.sha256}, here {found.sha256}",
            hint="the record is false, or the simulator is not deterministic: look before you delete it",
            path=str(path),
        )
    number = kept.number if kept is not None else 1 + max((one.number for one in earlier.values()), default=0)
    content: dict[str, Any] = {
        "format": 1,
        "number": number,
        "entry": run.digest,
        "commit": code_commit()["commit"],
        "fingerprint": dict(found.fingerprint),
        "rows": found.pack(),
    }
    write_atomic(path, json.dumps(content, indent=1) + "\n")
    return path


def why_not(run: Run) -> str:
    """Why a run is not verified, in a few words."""
    if run.kind == "entry" and run.recorded is None:
        return f"not verified: an entry of format 1 holds no actions, and was {NOT_SIMULATED}"
    if run.doubt:
        return run.doubt
    try:
        if run.provenance.protocol_hash != protocol_hash(run.task, run.protocol):
            return "another protocol version"
    except RemaError:
        return "another protocol version"
    return f"not verified: {NOT_SIMULATED}"
