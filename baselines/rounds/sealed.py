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

import pyarrow as pa
import pyarrow.compute as pc

from baselines.rounds.plan import BlockPlan, CollectionPlan
from baselines.rounds.recursion_plan import RecursionPlan, RoundPlan, networks_folder
from baselines.tae.checkpoint import networks_in
from evaluator.policy.shipped import CHECKPOINTS
from rema_data.errors import IntegrityError, RunMismatchError
from rema_data.json_files import read_json
from rema_data.locks import lock
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import BlockEntry
from rema_data.storage import storage_errors, write_atomic
from rema_data.store.block import EPISODES
from rema_data.store.columns import VARIATION, may_vary
from rema_data.store.tables import table_version, variation_of
from rema_data.validation import validated

__all__ = ["PLAYERS", "STAGES", "check_sealed", "note", "players_of", "read_notes"]

STAGES, PLAYERS = "stages.json", "players.json"
_CHANCE = 1e-9
"""What is less likely than this is not taken for chance: that all episodes of a block stay clean."""


def read_notes(path: Path) -> dict[str, Any]:
    """The content of a file of notes, empty without the file; IntegrityError where it is not a JSON object."""
    hint = "restore it, or delete it: its notes are then lost"
    try:
        with storage_errors(path):
            content = read_json(path) if path.is_file() else {}
    except ValueError as error:
        raise IntegrityError(f"{path} is not JSON: {error}", hint=hint, path=str(path)) from error
    return validated(dict[str, Any], content, str(path), hint=hint, error=IntegrityError)


def note(path: Path, key: str, value: Any) -> None:
    """Add or replace a note, while other processes may write into the file, too; errors as in ``read_notes``."""
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with lock(path.with_name(f".{path.name}.lock"), wait=True):  # held for milliseconds: wait for it
            write_atomic(path, json.dumps(read_notes(path) | {key: value}, indent=1) + "\n")


def players_of(entry: RoundPlan, releases: Path) -> dict[str, str]:
    """The networks that play a round, each with the sha256 of its weights; MissingFileError where one is absent."""
    return {
        f"{place}/{name}": hashlib.sha256(path.read_bytes()).hexdigest()
        for place in entry.played_by
        for name, path in networks_in(networks_folder(place, releases)).items()
    }


def check_sealed(plan: RecursionPlan, entry: RoundPlan, release: ReleaseFolder) -> None:
    """Raise where a sealed round is not the one that the plan asks for.

    Compared are the blocks, their episodes, the names of the policies of every step, the seed that the episodes
    record, the axes by which they are varied, and the networks that played, where the process that collected noted
    them. The code of the policies and the simulator are not compared: the sealed episodes stay valid when these change.

    Raises RunMismatchError; MissingFileError without a network that plays the round; IntegrityError for damaged tables.
    """
    planned = plan.collection(entry.number, release.root)
    if difference := _difference(planned, plan, entry, release):
        raise RunMismatchError(
            f"{release.path} {difference} round {entry.number} of {plan.path}",
            hint="undo the change, give the plan another name, or choose another folder with --output",
            path=str(release.path),
        )


def _difference(planned: CollectionPlan, plan: RecursionPlan, entry: RoundPlan, release: ReleaseFolder) -> str | None:
    blocks = {block.key: block for block in release.manifest.blocks if block.round == entry.number}
    if len(blocks) != len(planned.blocks) or not all(_fits(block, blocks.get(block.key)) for block in planned.blocks):
        return "holds other episodes than"
    for block in blocks.values():
        reader = release.block(block)
        if not (reader.folder / EPISODES).is_file():  # a block that was not fetched
            continue
        episodes = reader.episodes()
        for seed in episodes.column("seed").unique().to_pylist():
            if seed != planned.seed:
                return f"was drawn with the seed {seed}, not {planned.seed}, so it is not"
        (vary,) = (one.vary for one in planned.blocks if one.key == block.key)
        axes = _axes(episodes)
        if others := axes - set(vary.axes if vary is not None else ()):
            return f"has episodes that are varied by {', '.join(sorted(others))}, so it is not"
        by_chance = vary is not None and may_vary(table_version(episodes)) and vary.clean ** len(episodes) > _CHANCE
        if vary is not None and not axes and not by_chance:
            return "has no varied episodes, so it is not"
    recorded = read_notes(release.root / CHECKPOINTS / plan.name / PLAYERS).get(entry.release)
    if recorded is not None:
        present = players_of(entry, release.root)
        changed = sorted(name for name in {*recorded, *present} if recorded.get(name) != present.get(name))
        if changed:
            return f"was played by other networks ({', '.join(changed)}) than"
    return None


def _axes(episodes: pa.Table) -> set[str]:
    """The axes by which some episodes are varied."""
    varied = episodes.filter(pc.is_valid(episodes[VARIATION])).to_pylist()
    return {variation.axis for row in varied if (variation := variation_of(row)) is not None}


def _fits(planned: BlockPlan, block: BlockEntry | None) -> bool:
    """Whether a block holds what is planned; a step that no episode reached has no policy."""
    if block is None or block.episodes != planned.episodes:
        return False
    names = [use.spec.name for use in planned.policies]
    return all(found in ("", name) for name, found in zip(names, block.policies, strict=True))
