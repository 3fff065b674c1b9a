"""Collection plans: a TOML file that says which episodes are played, by whom, and what the release is called.

::

    name = "my-release"
    title = "..."
    description = "..."
    license = "CC-BY-4.0"                       # SPDX identifier
    citation = "..."
    published = "2030-01-31"                    # optional: the day
    seed = 1
    sources = []                                # optional: URLs from which people may fetch it
    parent = "my-older-release"                 # optional: a release on this machine

    [[rounds]]                                  # round 1
    reuse = true                                # its blocks are the parent's, unchanged

    [[rounds]]                                  # round 2
    policy = "random"                           # plays the last step of a task
    picks = "reference"                         # plays the steps before it
    episodes = { train = 200, val = 40 }
    tasks = ["grasp", "grasp_push"]

    [[rounds]]                                  # round 3: a task may have its own values
    picks = "reference"
    episodes = { train = 200, val = 40 }
    [rounds.tasks]
    grasp = { policy = { code = "my_policy.py:MyPolicy", checkpoint = "best.safetensors", device = "cpu" } }
    push = { policy = "scripted", episodes = { train = 50 } }

A policy is whatever ``rema evaluate`` takes. Files are looked for beside the plan.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

from baselines.devices import LEARNED
from baselines.rounds.planned import BlockPlan, CollectionPlan, PolicyUse
from evaluator.policy.loading import check_checkpoint, resolve
from evaluator.policy.shipped import shipped_checkpoint
from rema_data.errors import InputError, MissingFileError, RemaError
from rema_data.release.licences import KNOWN_LICENCES
from rema_data.release.manifest import check_name
from rema_data.release.seal import Description
from rema_data.schema import TASKS
from rema_data.store.block import SPLITS, BlockKey

__all__ = ["load_plan", "read_plan", "read_toml"]

_MAX_EPISODES = 2**31 - 1
_TEXTS = ("name", "title", "description", "license", "citation")
_TOP = (*_TEXTS, "published", "seed", "sources", "parent", "rounds")
_DEFAULTS = ("policy", "picks", "episodes")


def load_plan(path: Path) -> CollectionPlan:
    """Read and check a plan.

    Raises
    ------
    MissingFileError
        The plan, a policy or a checkpoint is not there.
    InputError
        It is not TOML, or a value cannot be used: the message names the file and the key.
    """
    return read_plan(read_toml(path), path)


def read_plan(content: dict[str, Any], path: Path, *, networks_later: bool = False) -> CollectionPlan:
    """Check a plan that was read already.

    Parameters
    ----------
    content : dict
    path : Path
        Of the file; the files that a plan names are looked for beside it.
    networks_later : bool
        The checkpoints that it names need not be there yet.

    Raises
    ------
    MissingFileError, InputError
        See ``load_plan``.
    """
    return _Reader(path, networks_later).plan(content)


def read_toml(path: Path) -> dict[str, Any]:
    """Content of a plan's file.

    Raises
    ------
    MissingFileError
        It is not there.
    InputError
        It is not TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise MissingFileError(f"there is no plan at {path}", hint="check the path", path=str(path)) from None
    except IsADirectoryError:
        raise InputError(
            f"{path} is a folder", hint="name the plan itself, such as plan.toml", path=str(path)
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is not TOML: {error}", hint="mend the file", path=str(path)) from error


class _Reader:
    """Checks a plan value by value; every complaint names the file and the key."""

    def __init__(self, path: Path, networks_later: bool) -> None:
        self._path, self._networks_later = path, networks_later

    def plan(self, content: dict[str, Any]) -> CollectionPlan:
        self._known("", content, _TOP)
        texts = {name: self._text(name, self._get("", content, name)) for name in _TEXTS}
        try:
            check_name(texts["name"])
        except InputError as error:
            raise self._wrong("name", error.message, error.hint) from error
        if texts["license"] not in KNOWN_LICENCES:
            hint = f"give an SPDX identifier: {', '.join(KNOWN_LICENCES)}"
            raise self._wrong("license", f"is {texts['license']!r}, which is not known here", hint)
        seed = self._whole("seed", self._get("", content, "seed"), 0, 2**63 - 1)
        sources = content.get("sources", [])
        if not isinstance(sources, list) or not all(isinstance(url, str) and url for url in sources):
            raise self._wrong("sources", "is not a list of URLs", 'write sources = ["https://..."]')
        parent = None if "parent" not in content else self._text("parent", content["parent"])
        if parent is not None and (self._path.parent / parent).is_dir():
            parent = str(self._path.parent / parent)
        rounds = self._get("", content, "rounds")
        if not isinstance(rounds, list) or not rounds or not all(isinstance(entry, dict) for entry in rounds):
            raise self._wrong("rounds", "is not a list of rounds", "write a table [[rounds]] for each")
        blocks: list[BlockPlan] = []
        reused: list[int] = []
        for number, entry in enumerate(rounds, 1):
            if self._reuses(number, entry, parent):
                reused.append(number)
            else:
                blocks += self._round(number, entry)
        if not blocks:
            raise self._wrong("rounds", "collect nothing", "give at least one round without `reuse`")
        about = Description(**texts, sources=tuple(sources), published=self._day(content.get("published", "")))
        return CollectionPlan(self._path, about, seed, tuple(blocks), tuple(reused), parent)

    def _reuses(self, number: int, entry: dict[str, Any], parent: str | None) -> bool:
        where = f"rounds[{number}]"
        if "reuse" not in entry:
            return False
        if entry["reuse"] is not True:
            raise self._wrong(f"{where}.reuse", f"is {entry['reuse']!r}", "write reuse = true, or leave it out")
        self._known(where, entry, ("reuse",))
        if parent is None:
            raise self._wrong(f"{where}.reuse", "has no parent to take the round from", 'name it: parent = "..."')
        return True

    def _round(self, number: int, entry: dict[str, Any]) -> list[BlockPlan]:
        where = f"rounds[{number}]"
        self._known(where, entry, (*_DEFAULTS, "tasks", "reuse"))
        tasks = self._get(where, entry, "tasks")
        if isinstance(tasks, list) and len({str(name) for name in tasks}) == len(tasks):
            tasks = {str(name): {} for name in tasks}
        if not isinstance(tasks, dict) or not tasks or not all(isinstance(value, dict) for value in tasks.values()):
            hint = 'write tasks = ["grasp", "push"], or a table [rounds.tasks] with grasp = { ... }'
            raise self._wrong(f"{where}.tasks", "is neither a list of different tasks nor a table of tables", hint)
        blocks = []
        for task, own in tasks.items():
            if task not in TASKS:
                raise self._wrong(f"{where}.tasks", f"has the unknown task {task!r}", f"tasks: {', '.join(TASKS)}")
            self._known(f"{where}.tasks.{task}", own, _DEFAULTS)
            values = {name: entry[name] for name in _DEFAULTS if name in entry} | own
            blocks += self._task(number, task, values)
        return blocks

    def _task(self, number: int, task: str, values: Mapping[str, Any]) -> list[BlockPlan]:
        where = f"rounds[{number}].tasks.{task}"
        last = self._policy(f"{where}.policy", self._get(where, values, "policy"))
        policies: tuple[PolicyUse, ...] = (last,)
        if len(TASKS[task]) > 1:
            picks = self._policy(f"{where}.picks", self._get(where, values, "picks"))
            policies = (*(picks,) * (len(TASKS[task]) - 1), last)
        episodes = self._get(where, values, "episodes")
        if not isinstance(episodes, dict) or not episodes:
            hint = "write episodes = { train = 200, val = 40 }"
            raise self._wrong(f"{where}.episodes", "does not say how many of each split", hint)
        self._known(f"{where}.episodes", episodes, SPLITS)
        counts = {
            split: self._whole(f"{where}.episodes.{split}", episodes[split], 1, _MAX_EPISODES)
            for split in SPLITS
            if split in episodes
        }
        return [BlockPlan(BlockKey(number, task, split), count, policies) for split, count in counts.items()]

    def _policy(self, where: str, value: Any) -> PolicyUse:
        table = {"code": value} if isinstance(value, str) else value
        if not isinstance(table, dict):
            hint = 'write "random", "my_policy.py:MyPolicy", or { code = "...", checkpoint = "...", device = "cpu" }'
            raise self._wrong(where, f"is {value!r}", hint)
        self._known(where, table, ("code", "checkpoint", "device"))
        code = self._text(f"{where}.code", self._get(where, table, "code"))
        device = self._text(f"{where}.device", table.get("device", "cpu"))
        try:
            spec = resolve(self._code(code))
            return PolicyUse(spec, self._checkpoint(where, table, spec.name), device)
        except RemaError as error:
            message = f"{self._path}: {where}: {error.message}"
            raise type(error)(message, hint=error.hint, **{**error.facts, "key": where}) from error

    def _checkpoint(self, where: str, table: Mapping[str, Any], policy: str) -> Path | None:
        """The networks that a policy names, else those that come with it."""
        if "checkpoint" not in table:
            shipped = shipped_checkpoint(policy)
            if shipped is None and policy in LEARNED:
                raise InputError(
                    f"{policy} has no networks of its own", hint='name them: { code = "tae", checkpoint = "FOLDER" }'
                )
            return shipped
        named = self._beside(self._text(f"{where}.checkpoint", table["checkpoint"]))
        return named if self._networks_later else check_checkpoint(named)

    def _beside(self, name: str) -> Path:
        """A file that the plan names: relative paths start in the plan's folder."""
        return self._path.parent / Path(name).expanduser()

    def _code(self, reference: str) -> str:
        """A file beside the plan as a path from here; a built-in name as it is."""
        return str(self._beside(reference)) if ".py" in reference else reference

    def _known(self, where: str, table: Mapping[str, Any], known: tuple[str, ...]) -> None:
        for name in table:
            if name not in known:
                key = f"{where}.{name}" if where else name
                raise self._wrong(key, "is not a key of a plan", f"known here: {', '.join(known)}")

    def _get(self, where: str, table: Mapping[str, Any], name: str) -> Any:
        if name not in table:
            raise self._wrong(f"{where}.{name}" if where else name, "is missing", f"give a value for {name}")
        return table[name]

    def _text(self, key: str, value: Any) -> str:
        if not isinstance(value, str) or not value.strip():
            raise self._wrong(key, f"is {value!r}, not a text", "write it in quotes")
        return value.strip()

    def _day(self, value: Any) -> str:
        try:
            return "" if value == "" else date.fromisoformat(self._text("published", value)).isoformat()
        except ValueError:
            raise self._wrong("published", f"is {value!r}, not a day", 'write published = "2030-01-31"') from None

    def _whole(self, key: str, value: Any, low: int, high: int) -> int:
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise self._wrong(key, f"is {value!r}", f"give a whole number from {low} to {high}")
        return value

    def _wrong(self, key: str, what: str, hint: str) -> InputError:
        return InputError(f"{self._path}: {key} {what}", hint=hint, path=str(self._path), key=key)
