"""Plans of the recursion: a TOML file with rounds, and the networks that are trained after each.

::

    name = "my-recursion"                       # title, description, license, citation, seed: as in a collection plan
    begins_with = "rema-v0"                     # optional: whose first rounds are reused
    policies = { tae-joint = "joint" }          # optional: what --register enters as the networks of a built-in policy
    ...

    [[rounds]]                                  # round 1: as in a collection plan
    policy = "random"
    episodes = { train = 10000, val = 2000 }
    tasks = ["grasp"]

    [[rounds.networks]]                         # trained on rounds 1 to 1, when they are sealed
    network = "round-1/grasp"                   # releases/checkpoints/my-recursion/round-1/grasp.safetensors
    primitive = "grasp"                         # and whatever else a training has: baselines.train.config
    tasks = ["grasp"]
    updates = 160000

    [[rounds]]                                  # round 2
    policy = { code = "tae", checkpoint = "my-recursion/round-1" }      # networks of an earlier round, by their folder
    episodes = { train = 10000, val = 2000 }
    tasks = ["grasp"]

Round n is sealed as ``NAME-round-n``, the last one as ``NAME``: each continues the one before and shares its blocks.
"""

from __future__ import annotations

import copy
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baselines.devices import LEARNED
from baselines.rounds.plan import read_plan, read_toml
from baselines.rounds.planned import CollectionPlan
from baselines.train.config import TrainingConfig
from baselines.train.result import NAME
from evaluator.policy.shipped import CHECKPOINTS
from rema_data.errors import InputError, MissingFileError, RemaError
from rema_data.release.manifest import check_name

__all__ = ["NetworkPlan", "RecursionPlan", "RoundPlan", "load_recursion", "networks_folder"]

_OWN = ("begins_with", "policies", "rounds")
_TOP = ("name", "title", "description", "license", "citation", "published", "seed", "sources", *_OWN)
_NETWORK = re.compile(rf"[a-z0-9][a-z0-9._-]*/{NAME}")


@dataclass(frozen=True, slots=True)
class NetworkPlan:
    """A network to be trained.

    Attributes
    ----------
    folder, name : str
        ``checkpoints/PLAN/FOLDER/NAME.safetensors``.
    config : TrainingConfig
    """

    folder: str
    name: str
    config: TrainingConfig


@dataclass(frozen=True, slots=True)
class RoundPlan:
    """A round.

    Attributes
    ----------
    number : int
        From 1.
    release : str
        Name of the release that holds the rounds up to this one.
    collection : dict or None
        Of the round, as a collection plan has it; None for a round that is reused.
    networks : tuple of NetworkPlan
        Trained on that release.
    """

    number: int
    release: str
    collection: dict[str, Any] | None
    networks: tuple[NetworkPlan, ...]

    @property
    def played_by(self) -> tuple[str, ...]:
        """Folders, below ``checkpoints``, of the networks that its policies name."""
        return tuple(sorted({str(use["checkpoint"]) for use in _uses(self.collection)}))


@dataclass(frozen=True, slots=True)
class RecursionPlan:
    """A whole recursion.

    Attributes
    ----------
    path : Path
        Of the file.
    about : dict
        The texts and the seed, as a collection plan has them.
    rounds : tuple of RoundPlan
    policies : dict of str to str
        Built-in policies whose networks are trained here, with the folder of each.
    """

    path: Path
    about: dict[str, Any]
    rounds: tuple[RoundPlan, ...]
    policies: dict[str, str]

    @property
    def name(self) -> str:
        """Of the recursion, and of its last release."""
        return str(self.about["name"])

    def collection(self, number: int, releases: Path) -> CollectionPlan:
        """Collection plan of a round: its networks have to be there by now.

        Raises
        ------
        MissingFileError, InputError
            As for any collection plan.
        """
        entry = self.rounds[number - 1]
        assert entry.collection is not None
        content = self._content(number, _with_checkpoints(entry.collection, releases))
        if number > 1:
            content["parent"] = str((releases / self.rounds[number - 2].release).resolve())
        if number < len(self.rounds):
            content["title"] = f"{self.about['title']}: rounds 1 to {number}"
        return read_plan(content, self.path)

    def outline(self, number: int) -> CollectionPlan:
        """The same while its networks and the rounds before it are not there yet.

        Raises
        ------
        MissingFileError, InputError
            As for any collection plan.
        """
        collection = self.rounds[number - 1].collection
        assert collection is not None
        content = self._content(number, collection) | {"parent": self.rounds[0].release}
        return read_plan(content, self.path, networks_later=True)

    def _content(self, number: int, collection: dict[str, Any]) -> dict[str, Any]:
        rounds = [*[{"reuse": True}] * (number - 1), collection]
        return {**self.about, "name": self.rounds[number - 1].release, "rounds": rounds}


def networks_folder(place: str, releases: Path) -> Path:
    """Where the networks lie that a plan names as players.

    Raises
    ------
    MissingFileError
        They are not there.
    """
    folder = releases / CHECKPOINTS / place
    if not folder.exists():
        raise MissingFileError(
            f"there are no networks {place} in {releases / CHECKPOINTS}, and a round is played by them",
            hint="run the plan that trains them into the same folder, or copy them there from where it was run",
            path=str(folder),
        )
    return folder


def load_recursion(path: Path) -> RecursionPlan:
    """Read and check a plan of rounds.

    Raises
    ------
    MissingFileError
        The file is not there.
    InputError
        A value cannot be used, a field is unknown, a policy's networks are not trained by an earlier round, or a
        network has nothing to be trained on.
    """
    content = read_toml(path)
    unknown = [name for name in content if name not in _TOP]
    if unknown:
        raise InputError(f"{path}: {unknown[0]} is not a key of a recursion", hint=f"known here: {', '.join(_TOP)}")
    entries = content.get("rounds")
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        raise InputError(f"{path}: rounds is not a list of rounds", hint="write a table [[rounds]] for each")
    about = {key: value for key, value in content.items() if key not in _OWN}
    try:
        name, base = check_name(str(content.get("name", ""))), content.get("begins_with")
    except InputError as error:
        raise InputError(f"{path}: name: {error.message}", hint=error.hint) from error
    if base is not None and not isinstance(base, str):
        raise InputError(f"{path}: begins_with = {base!r} is no name", hint='write begins_with = "rema-v0"')
    rounds = _rounds(path, entries, name, base)
    folders = {network.folder for entry in rounds for network in entry.networks}
    plan = RecursionPlan(path, about, rounds, _policies(path, content.get("policies", {}), folders))
    _check_data(plan)
    return plan


def _rounds(path: Path, entries: list[dict[str, Any]], name: str, base: str | None) -> tuple[RoundPlan, ...]:
    rounds: list[RoundPlan] = []
    for number, entry in enumerate(entries, 1):
        own = copy.deepcopy(entry)
        tables = own.pop("networks", [])
        if not isinstance(tables, list):
            raise InputError(
                f"{path}: rounds[{number}].networks is {tables!r}", hint="write a table [[rounds.networks]] for each"
            )
        networks = tuple(_network(path, number, table) for table in tables)
        used = {network.folder for earlier in rounds for network in earlier.networks}
        _check_places(path, number, networks, used)
        if own.get("reuse") is True:
            if base is None:
                raise InputError(f"{path}: rounds[{number}].reuse lacks its source", hint='write begins_with = "..."')
            if any(earlier.collection is not None for earlier in rounds):
                raise InputError(
                    f"{path}: rounds[{number}] is reused after a round that is collected, and would not hold it",
                    hint="rounds that are reused come first",
                )
            if others := [key for key in own if key != "reuse"]:
                raise InputError(
                    f"{path}: rounds[{number}].{others[0]} is not a key of a round that is reused",
                    hint="known here: reuse, networks; leave out reuse to collect the round",
                )
            rounds.append(RoundPlan(number, f"{base}-round-{number}", None, networks))
        else:
            _check_players(path, number, own, {f"{name}/{folder}" for folder in used}, base)
            release = name if number == len(entries) else f"{name}-round-{number}"
            rounds.append(RoundPlan(number, release, own, networks))
    return tuple(rounds)


def _network(path: Path, number: int, table: Any) -> NetworkPlan:
    where = f"{path}: rounds[{number}].networks"
    values = dict(table) if isinstance(table, dict) else {}
    place = values.pop("network", None)
    if not isinstance(place, str) or not _NETWORK.fullmatch(place):
        raise InputError(f"{where}: network = {place!r} names no network", hint='write network = "round-1/grasp"')
    folder, _, name = place.partition("/")
    try:
        return NetworkPlan(folder, name, TrainingConfig.from_dict(values))
    except RemaError as error:
        raise InputError(f"{where}: {place}: {error.message}", hint=error.hint, network=place) from error


def _uses(table: Any) -> list[dict[str, Any]]:
    """Every policy below a table that names a checkpoint."""
    if not isinstance(table, dict):
        return []
    here = [table] if "code" in table and "checkpoint" in table else []
    return here + [use for value in table.values() for use in _uses(value)]


def _check_players(path: Path, number: int, table: dict[str, Any], known: set[str], base: str | None) -> None:
    for use in _uses(table):
        place = str(use["checkpoint"])
        if place not in known and not (base and place.startswith(f"{base}/")):
            listed = ", ".join(sorted(known)) or "none"
            raise InputError(
                f"{path}: rounds[{number}] is played by {place}, which no earlier round trains",
                hint=f"networks by then: {listed}",
                checkpoint=place,
            )


def _check_places(path: Path, number: int, networks: tuple[NetworkPlan, ...], used: set[str]) -> None:
    """A folder of networks belongs to one round: those of an earlier one may have played, and stay what they were."""
    places = [f"{network.folder}/{network.name}" for network in networks]
    for network, place in zip(networks, places, strict=True):
        if network.folder in used or places.count(place) > 1:
            raise InputError(
                f"{path}: rounds[{number}].networks: {place} is trained twice, or into the folder of an earlier round",
                hint="give every round folders of its own, and every network in them its own name",
                network=place,
            )


def _policies(path: Path, table: Any, folders: set[str]) -> dict[str, str]:
    """Which built-in policies get which networks."""
    if not isinstance(table, dict) or not all(folder in folders for folder in map(str, table.values())):
        raise InputError(
            f"{path}: policies = {table!r} names networks that no round trains",
            hint=f"folders of networks: {', '.join(sorted(folders)) or 'none'}",
        )
    if unknown := sorted(set(table) - LEARNED):
        raise InputError(
            f"{path}: policies.{unknown[0]} is no policy with networks", hint=f"use: {', '.join(sorted(LEARNED))}"
        )
    return table


def _check_data(plan: RecursionPlan) -> None:
    """Every complaint about the data before hours of work begin; what is reused is not known yet."""
    collected: set[tuple[str, str]] = set()
    reused = any(entry.collection is None for entry in plan.rounds)
    for entry in plan.rounds:
        if entry.collection is not None:
            collected |= {(block.key.task, block.key.split) for block in plan.outline(entry.number).blocks}
        for network in () if reused else entry.networks:
            for task in network.config.tasks:
                for split in ("train", "val"):
                    if (task, split) not in collected:
                        raise InputError(
                            f"{plan.path}: rounds[{entry.number}].networks: {network.folder}/{network.name} learns "
                            f"{task}, of which no round so far has episodes in the split {split}",
                            hint="collect them, or leave the task out",
                            network=f"{network.folder}/{network.name}",
                        )


def _with_checkpoints(table: dict[str, Any], releases: Path) -> dict[str, Any]:
    made = copy.deepcopy(table)
    for use in _uses(made):
        use["checkpoint"] = str(networks_folder(str(use["checkpoint"]), releases).resolve())
    return made
