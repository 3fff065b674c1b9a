"""Plans of the recursion: a TOML file with rounds, and the networks that are trained after each.

::

    name = "my-recursion"                       # title, description, license, citation, seed: as in a collection plan
    begins_with = "rema-v0"                     # optional: whose first rounds are reused, but not its last one; or
    continues = "rema-v0"                       # whose rounds are reused, all of them
    policies = { tae-joint = "joint" }          # optional: what --register enters as the networks of a built-in policy;
                                                # or { tae-joint = { grasp_grasp_push = "joint" } }: in this task alone
    ...

    [[rounds]]                                  # round 1: as in a collection plan
    policy = "random"
    episodes = { train = 10000, val = 2000 }
    tasks = ["grasp"]

    [[rounds.networks]]                         # trained on rounds 1 to 1, when they are sealed
    network = "round-1/grasp"                   # releases/checkpoints/my-recursion/round-1/grasp.safetensors
    primitive = "grasp"                         # and further fields of a training: baselines.train.config
    tasks = ["grasp"]
    updates = 160000

    [[rounds]]                                  # round 2
    policy = { code = "tae", checkpoint = "my-recursion/round-1" }      # networks of an earlier round, by their folder
    episodes = { train = 10000, val = 2000 }
    tasks = ["grasp"]

Round n is sealed as ``NAME-round-n``, the last one as ``NAME``: each continues the one before and shares its blocks.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Annotated, Any

from pydantic import StringConstraints, model_validator

from baselines.devices import LEARNED
from baselines.rounds.plan import About, CollectionPlan, Text, read_plan, read_toml, reuses, wrong
from baselines.train.config import TrainingConfig
from baselines.train.result import NAME
from evaluator.policy.shipped import CHECKPOINTS
from rema_data.errors import MissingFileError
from rema_data.schema import TASKS
from rema_data.store.block import SPLITS
from rema_data.validation import record, validated

__all__ = ["NetworkPlan", "Published", "RecursionPlan", "RoundPlan", "load_recursion", "networks_folder"]

_HINT = "fix the plan; examples/tiny.toml shows how one is written"
_OWN = ("begins_with", "continues", "policies", "rounds")
"""Fields that a collection plan does not have, or has otherwise."""
_PLACE = 'write where it is stored, below the networks of this plan: network = "round-1/grasp"'


@dataclass(frozen=True, slots=True)
class NetworkPlan:
    """A network to be trained: ``checkpoints/PLAN/FOLDER/NAME.safetensors``."""

    folder: str
    name: str
    config: TrainingConfig


@dataclass(frozen=True, slots=True)
class RoundPlan:
    """A round."""

    number: int  # from 1
    release: str  # name of the release that holds the rounds up to this one
    collection: dict[str, Any] | None  # as a collection plan has it; None for a round that is reused
    networks: tuple[NetworkPlan, ...]  # trained on that release

    @property
    def played_by(self) -> tuple[str, ...]:
        """Folders, below ``checkpoints``, of the networks that its policies name."""
        return tuple(sorted({str(use["checkpoint"]) for use in _uses(self.collection)}))


@dataclass(frozen=True, slots=True)
class Published:
    """What is registered as the networks of a built-in policy: a folder, in one task or (None) in all others."""

    policy: str
    folder: str
    task: str | None = None


@dataclass(frozen=True, slots=True)
class RecursionPlan:
    """A whole recursion."""

    path: Path
    about: dict[str, Any]  # the texts and the seed, as a collection plan has them
    rounds: tuple[RoundPlan, ...]
    policies: tuple[Published, ...]  # built-in policies whose networks are trained here
    continues: str | None  # the recursion whose rounds are the first ones

    @property
    def name(self) -> str:
        """Of the recursion, and of its last release."""
        return str(self.about["name"])

    def collection(self, number: int, releases: Path) -> CollectionPlan:
        """Collection plan of a round, whose networks have to be there; errors are those of ``load_plan``."""
        content = self._content(number)
        if number > 1:
            content["parent"] = str((releases / self.rounds[number - 2].release).resolve())
        if number < len(self.rounds):
            content["title"] = f"{self.about['title']}: rounds 1 to {number}"
        return read_plan(content, self.path, lambda place: networks_folder(place, releases).resolve())

    def outline(self, number: int) -> CollectionPlan:
        """The same while its networks and the rounds before it are not there yet."""
        return read_plan(self._content(number) | {"parent": self.rounds[0].release}, self.path, Path)

    def _content(self, number: int) -> dict[str, Any]:
        entry = self.rounds[number - 1]
        assert entry.collection is not None
        rounds = [*[{"reuse": True}] * (number - 1), entry.collection]
        return {**self.about, "name": entry.release, "rounds": rounds}


@record
class _Recursion(About):
    begins_with: Text | None = None
    continues: Text | None = None
    policies: dict[str, str | dict[str, str]] = field(default_factory=dict)

    @model_validator(mode="after")
    def _has_one_beginning(self) -> _Recursion:
        if self.begins_with and self.continues:
            raise ValueError("begins_with and continues cannot both be given")
        return self

    @property
    def earlier(self) -> str | None:
        """The recursion whose rounds are reused."""
        return self.begins_with or self.continues


@record
class _Networks:
    networks: list[dict[str, Any]] = field(default_factory=list)


@record
class _Place:
    network: Annotated[str, StringConstraints(pattern=rf"^[a-z0-9][a-z0-9._-]*/{NAME}$")]


def networks_folder(place: str, releases: Path) -> Path:
    """Where the networks lie that play a round; MissingFileError where they are not there."""
    folder = releases / CHECKPOINTS / place
    if not folder.exists():
        raise MissingFileError(
            f"there are no networks {place} in {releases / CHECKPOINTS}, and a round is played by them",
            hint="run the plan that trains them into the same folder, or copy them there from where it was run",
            path=str(folder),
        )
    return folder


def load_recursion(path: Path) -> RecursionPlan:
    """Read and check a plan of rounds; raises MissingFileError without the file.

    Raises InputError where a value cannot be used, a field is unknown, a policy's networks are not trained by an
    earlier round, or a network has nothing to be trained on.
    """
    content = read_toml(path)
    own = validated(_Recursion, content, str(path), hint=_HINT)
    about = {key: value for key, value in content.items() if key not in _OWN}
    plan = RecursionPlan(path, about, _rounds(path, own), _published(own), own.continues)
    folders = {network.folder for entry in plan.rounds for network in entry.networks}
    for one in plan.policies:
        if one.policy not in LEARNED or one.folder not in folders or one.task not in (None, *TASKS):
            where = f"policies.{one.policy}" + ("" if one.task is None else f".{one.task}")
            what = f"is {one.folder!r}: not a learned policy with networks that a round trains, or not for a task"
            hint = f"policies: {_listed(LEARNED)}; networks: {_listed(folders)}; tasks: {', '.join(TASKS)}"
            raise wrong(path, where, what, hint)
    _check_data(plan)
    return plan


def _published(own: _Recursion) -> tuple[Published, ...]:
    found: list[Published] = []
    for policy, folders in own.policies.items():
        given = {None: folders} if isinstance(folders, str) else folders
        found += [Published(policy, folder, task) for task, folder in given.items()]
    return tuple(found)


def _rounds(path: Path, own: _Recursion) -> tuple[RoundPlan, ...]:
    rounds: list[RoundPlan] = []
    for number, table in enumerate(own.rounds, 1):
        where = f"rounds[{number}]"
        collection = {key: value for key, value in table.items() if key != "networks"}
        used = {network.folder for earlier in rounds for network in earlier.networks}
        networks = _networks(path, where, table, used)
        if reuses(collection, path, where):
            if own.earlier is None:
                raise wrong(path, f"{where}.reuse", "lacks its source", 'write begins_with or continues = "..."')
            if any(earlier.collection is not None for earlier in rounds):
                what = "is reused after a round that is collected, and would not hold it"
                raise wrong(path, where, what, "rounds that are reused come first")
            following = own.rounds[number] if number < len(own.rounds) else {}
            whole = own.continues is not None and "reuse" not in following  # the last round has the recursion's name
            release = own.earlier if whole else f"{own.earlier}-round-{number}"
            rounds.append(RoundPlan(number, release, None, networks))
            continue
        release = own.name if number == len(own.rounds) else f"{own.name}-round-{number}"
        entry = RoundPlan(number, release, collection, networks)
        known = {f"{own.name}/{folder}" for folder in used}
        for place in entry.played_by:
            if place not in known and not (own.earlier and place.startswith(f"{own.earlier}/")):
                what = f"is played by {place}, which no earlier round trains"
                raise wrong(path, where, what, f"networks by then: {_listed(known)}")
        rounds.append(entry)
    return tuple(rounds)


def _networks(path: Path, where: str, table: dict[str, Any], used: set[str]) -> tuple[NetworkPlan, ...]:
    """The networks of a round: where each is written, and how it is trained."""
    given = {key: value for key, value in table.items() if key == "networks"}
    found: list[NetworkPlan] = []
    for number, values in enumerate(validated(_Networks, given, str(path), at=where, hint=_HINT).networks, 1):
        at = f"{where}.networks[{number}]"
        place = {"network": values.pop("network")} if "network" in values else {}
        folder, _, name = validated(_Place, place, str(path), at=at, hint=_PLACE).network.partition("/")
        # A folder of networks belongs to one round: those of an earlier one may have played, and stay what they were.
        if folder in used or (folder, name) in {(one.folder, one.name) for one in found}:
            what = f"{folder}/{name} is trained twice, or into the folder of an earlier round"
            hint = "give every round folders of its own, and every network in them its own name"
            raise wrong(path, f"{where}.networks:", what, hint)
        found.append(NetworkPlan(folder, name, validated(TrainingConfig, values, str(path), at=at, hint=_HINT)))
    return tuple(found)


def _uses(table: Any) -> list[dict[str, Any]]:
    """Every policy below a table that names a checkpoint."""
    if not isinstance(table, dict):
        return []
    here = [table] if "code" in table and "checkpoint" in table else []
    return here + [use for value in table.values() for use in _uses(value)]


def _listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(names)) or "none"


def _check_data(plan: RecursionPlan) -> None:
    """Check before hours of work that every network has data; the data of reused rounds are not known yet."""
    collected: set[tuple[str, str]] = set()
    reused = any(entry.collection is None for entry in plan.rounds)
    for entry in plan.rounds:
        if entry.collection is not None:
            collected |= {(block.key.task, block.key.split) for block in plan.outline(entry.number).blocks}
        for network in () if reused else entry.networks:
            for task, split in product(network.config.tasks, SPLITS):
                if (task, split) not in collected:
                    place = f"{network.folder}/{network.name}"
                    what = f"{place} learns {task}, of which no round so far has episodes in the split {split}"
                    hint = "collect them, or leave the task out"
                    raise wrong(plan.path, f"rounds[{entry.number}].networks:", what, hint)
