"""What a recursion left: whether a sealed release is the round that a plan asks for, and notes beside the networks.

The notes are two small files, written by every process that works on the recursion::

    stages.json      what every stage took on the machine that finished it
    players.json     which networks each round was collected with: the sha256 of their weights
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from filelock import FileLock

from baselines.rounds.plan import BlockPlan, CollectionPlan
from baselines.rounds.recursion_plan import RecursionPlan, RoundPlan, networks_folder
from baselines.tae.checkpoint import networks_in
from evaluator.policy.shipped import CHECKPOINTS
from rema_data.errors import IntegrityError, RunMismatchError
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import BlockEntry
from rema_data.storage import storage_errors, write_atomic
from rema_data.store.block import EPISODES
from rema_data.validation import validated

__all__ = ["PLAYERS", "STAGES", "check_sealed", "note", "players_of", "read_notes"]

STAGES, PLAYERS = "stages.json", "players.json"


def read_notes(path: Path) -> dict[str, Any]:
    """What a file of notes holds; nothing where it is not there.

    Raises
    ------
    IntegrityError
        It is not a JSON object.
    """
    hint = "restore it, or delete it: its notes are then lost"
    with storage_errors(path):
        text = path.read_text(encoding="utf-8") if path.is_file() else "{}"
    try:
        return validated(dict[str, Any], json.loads(text), str(path), hint=hint, error=IntegrityError)
    except json.JSONDecodeError as error:
        raise IntegrityError(f"{path} is not JSON: {error}", hint=hint, path=str(path)) from error


def note(path: Path, key: str, value: Any) -> None:
    """Enter a note, or replace it, while other processes may write into the file too.

    Raises
    ------
    IntegrityError
        The file is not a JSON object.
    StorageError
        It may not be written.
    """
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(path.with_name(f".{path.name}.lock")):  # held for milliseconds: wait for it
            write_atomic(path, json.dumps(read_notes(path) | {key: value}, indent=1) + "\n")


def players_of(entry: RoundPlan, releases: Path) -> dict[str, str]:
    """The networks that a round names as its players, each with the sha256 of its weights.

    Raises
    ------
    MissingFileError
        One is not there.
    """
    found = {}
    for place in entry.played_by:
        for name, path in networks_in(networks_folder(place, releases)).items():
            found[f"{place}/{name}"] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def check_sealed(plan: RecursionPlan, entry: RoundPlan, release: ReleaseFolder) -> None:
    """Raise where a sealed round is not the one that the plan asks for.

    Compared are its blocks, their episodes, the names of the policies of every step, the seed that the episodes
    record, and the networks that played, where the process that collected noted them. The code of the policies and the
    simulator are not: both may have changed since, and the sealed episodes are no worse for it.

    Parameters
    ----------
    plan : RecursionPlan
    entry : RoundPlan
        A round that the plan collects itself.
    release : ReleaseFolder

    Raises
    ------
    RunMismatchError
    MissingFileError
        A network that plays the round is not there.
    IntegrityError
        A table of the release is damaged.
    """
    planned = plan.collection(entry.number, release.root)
    blocks = {block.key: block for block in release.manifest.blocks if block.round == entry.number}
    if len(blocks) != len(planned.blocks) or not all(_fits(block, blocks.get(block.key)) for block in planned.blocks):
        raise _other(plan, entry, release, "holds other episodes than")
    _check_seed(plan, entry, release, planned)
    recorded = read_notes(release.root / CHECKPOINTS / plan.name / PLAYERS).get(entry.release)
    if recorded is not None:
        present = players_of(entry, release.root)
        changed = sorted(name for name in {*recorded, *present} if recorded.get(name) != present.get(name))
        if changed:
            raise _other(plan, entry, release, f"was played by other networks ({', '.join(changed)}) than")


def _check_seed(plan: RecursionPlan, entry: RoundPlan, release: ReleaseFolder, planned: CollectionPlan) -> None:
    for block in release.manifest.blocks:
        reader = release.block(block)
        if block.round != entry.number or not (reader.folder / EPISODES).is_file():  # a part that was not fetched
            continue
        for seed in reader.episodes().column("seed").unique().to_pylist():
            if seed != planned.seed:
                what = f"was drawn with the seed {seed}, not {planned.seed}, so it is not"
                raise _other(plan, entry, release, what)


def _other(plan: RecursionPlan, entry: RoundPlan, release: ReleaseFolder, what: str) -> RunMismatchError:
    return RunMismatchError(
        f"{release.path} {what} round {entry.number} of {plan.path}",
        hint="undo the change, give the plan another name, or choose another folder with --output",
        path=str(release.path),
    )


def _fits(planned: BlockPlan, block: BlockEntry | None) -> bool:
    """Whether a block holds what is planned; a step that no episode reached has no policy."""
    if block is None or block.episodes != planned.episodes:
        return False
    names = [use.spec.name for use in planned.policies]
    return all(found in ("", name) for name, found in zip(names, block.policies, strict=True))
