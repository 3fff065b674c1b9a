"""Collection plans: a TOML file that says which episodes are played, by which policies, and what the release is called.

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

    vary = ["clutter", "shape", "sense"]        # optional: half of the episodes are clean, in the others one of these
                                                # axes of the suites changes the last step (docs/suite.md);
                                                # or vary = { axes = ["clutter"], clean = 0.2 }

    [[rounds]]                                  # round 3: a task may have its own values
    picks = "reference"
    episodes = { train = 200, val = 40 }
    [rounds.tasks]
    grasp = { policy = { code = "my_policy.py:MyPolicy", checkpoint = "best.safetensors", device = "cpu" } }
    push = { policy = "scripted", episodes = { train = 50 } }

A policy is named as for ``rema evaluate``. Files are looked for beside the plan.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, StringConstraints, ValidationInfo, field_validator

from baselines.devices import LEARNED, inference_device
from evaluator.policy.loading import PolicySpec, check_checkpoint, resolve, weights_of
from evaluator.scenarios.axes import AXES
from evaluator.scenarios.varied import CLEAN, Vary, axes_in
from rema_data.errors import InputError, MissingFileError, RemaError
from rema_data.json_files import bounded_file
from rema_data.release.licences import KNOWN_LICENCES
from rema_data.release.manifest import check_name
from rema_data.release.seal import Description
from rema_data.schema import TASKS
from rema_data.store.block import SPLITS, BlockKey
from rema_data.validation import record, validated

__all__ = ["BlockPlan", "CollectionPlan", "PolicyUse", "load_plan", "read_plan", "read_toml"]

_HINT = "fix the plan; examples/collect_plan.toml shows how one is written"
_MOST_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class PolicyUse:
    """A behaviour policy: its code, weights and device."""

    spec: PolicySpec
    checkpoint: Path | None = None
    device: str = "cpu"


@dataclass(frozen=True, slots=True)
class BlockPlan:
    """What one block is to hold, with the policy of every step of its task."""

    key: BlockKey
    episodes: int
    policies: tuple[PolicyUse, ...]
    vary: Vary | None = None  # None where all episodes are clean


@dataclass(frozen=True, slots=True)
class CollectionPlan:
    """A plan whose every value is known to be usable."""

    path: Path
    about: Description
    seed: int
    blocks: tuple[BlockPlan, ...]  # to be played, in the order of the file
    reused: tuple[int, ...] = ()  # rounds taken from the parent
    parent: str | None = None  # name or folder of a release

    def check_devices(self) -> None:
        """Raise an InputError where a learned policy is to compute on a device that this machine lacks."""
        for block in self.blocks:
            for device in {use.device for use in block.policies if use.spec.name in LEARNED}:
                try:
                    inference_device(device)
                except InputError as error:
                    number = block.key.round
                    what = f"{self.path}: rounds[{number}] is played on the device {device}: {error.message}"
                    raise InputError(what, hint=error.hint, round=number) from error


Text = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]
_Count = Annotated[int, Field(ge=1, le=2**31 - 1)]
_Networks = Callable[[str], Path | None]


def _licence(name: str) -> str:
    if name not in KNOWN_LICENCES:
        raise ValueError(f"is {name!r}: use one of the SPDX identifiers {', '.join(KNOWN_LICENCES)}")
    return name


def _day(text: str) -> str:
    try:
        return text and date.fromisoformat(text.strip()).isoformat()
    except ValueError:
        raise ValueError(f"is {text!r}, not a day such as 2030-01-31") from None


@record
class About:
    """The fields of both kinds of plans. Rounds are checked one by one, since messages count them from 1."""

    name: Annotated[Text, AfterValidator(check_name)]
    title: Text
    description: Text
    license: Annotated[Text, AfterValidator(_licence)]
    citation: Text
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    rounds: Annotated[list[dict[str, Any]], Field(min_length=1)]
    sources: tuple[Text, ...] = ()
    published: Annotated[str, AfterValidator(_day)] = ""


@record
class _Collection(About):
    parent: Text | None = None


@record
class _Policy:
    code: Text
    checkpoint: Text | None = None
    device: Text = "cpu"


_Use = Annotated[_Policy, BeforeValidator(lambda value: {"code": value} if isinstance(value, str) else value)]


def _axes(names: list[str]) -> list[str]:
    for name in names:
        if name not in AXES:
            raise ValueError(f"has the axis {name!r}: use some of {', '.join(AXES)}")
    if len(set(names)) < len(names):
        raise ValueError("names an axis twice")
    return names


@record
class _Vary:
    axes: Annotated[list[str], Field(min_length=1), AfterValidator(_axes)]
    clean: Annotated[float, Field(ge=0, lt=1)] = CLEAN


_Varied = Annotated[_Vary, BeforeValidator(lambda value: {"axes": value} if isinstance(value, list) else value)]


@record
class _Task:
    policy: _Use
    episodes: Annotated[dict[Literal["train", "val"], _Count], Field(min_length=1)]
    picks: _Use | None = None
    vary: _Varied | None = None


@record
class _Round:
    policy: Any = None
    picks: Any = None
    episodes: Any = None
    vary: Any = None
    tasks: Annotated[dict[str, _Task], Field(validate_default=True)] = field(default_factory=dict)

    @field_validator("tasks", mode="before")
    @classmethod
    def _by_task(cls, tasks: Any, info: ValidationInfo) -> dict[str, Any]:
        """Every task with its own table, filled up with the values of the round."""
        if isinstance(tasks, list) and len(set(map(str, tasks))) == len(tasks):
            tasks = {str(name): {} for name in tasks}
        if not isinstance(tasks, dict) or not tasks:
            raise ValueError('is not a list of different tasks, such as ["grasp", "push"], nor a table of tables')
        for name, own in tasks.items():
            if name not in TASKS or not isinstance(own, dict):
                raise ValueError(f"has {name!r} = {own!r}: a task is one of {', '.join(TASKS)}, its values are a table")
        given = {name: value for name, value in info.data.items() if value is not None}
        return {name: given | own for name, own in tasks.items()}


@record
class _Reused:
    reuse: bool


def load_plan(path: Path) -> CollectionPlan:
    """Read and check a plan; InputError names the file and the key, MissingFileError the file that is not there."""
    return read_plan(read_toml(path), path)


def read_toml(path: Path) -> dict[str, Any]:
    """Content of a plan's file; MissingFileError without it, InputError where it is not TOML."""
    try:
        return tomllib.loads(bounded_file(path, _MOST_BYTES).decode("utf-8"))
    except FileNotFoundError:
        raise MissingFileError(f"there is no plan at {path}", hint="check the path", path=str(path)) from None
    except IsADirectoryError:
        raise InputError(
            f"{path} is a folder", hint="name the plan itself, such as plan.toml", path=str(path)
        ) from None
    except RecursionError as error:
        raise InputError(f"{path} is nested too deeply", hint="fix the file", path=str(path)) from error
    except ValueError as error:
        raise InputError(f"{path} is not TOML: {error}", hint="fix the file", path=str(path)) from error


def reuses(table: dict[str, Any], path: Path, where: str) -> bool:
    """Whether a round is one of an earlier release, and says no more than that."""
    hint = "write reuse = true alone, or leave it out"
    return "reuse" in table and validated(_Reused, table, str(path), at=where, hint=hint).reuse


def read_plan(content: dict[str, Any], path: Path, checkpoint: _Networks | None = None) -> CollectionPlan:
    """Check the content of a plan; its files are looked for beside ``path``. Errors are those of ``load_plan``.

    ``checkpoint`` gives the folder of the networks that a plan names; by default they are beside ``path``, too.
    """
    plan = validated(_Collection, content, str(path), hint=_HINT)
    networks = checkpoint or (lambda name: check_checkpoint(path.parent / os.path.expanduser(name)))
    blocks: list[BlockPlan] = []
    reused: list[int] = []
    for number, table in enumerate(plan.rounds, 1):
        where = f"rounds[{number}]"
        if reuses(table, path, where):
            if plan.parent is None:
                raise wrong(path, f"{where}.reuse", "has no parent to take the round from", 'name it: parent = "..."')
            reused.append(number)
            continue
        tasks = validated(_Round, table, str(path), at=where, hint=_HINT).tasks
        _check_axes(path, where, tasks)
        for task, values in tasks.items():
            policies = _policies(path, f"{where}.tasks.{task}", task, values, networks)
            counts = [(split, values.episodes[split]) for split in SPLITS if split in values.episodes]
            vary = _vary(task, values)
            blocks += [BlockPlan(BlockKey(number, task, split), count, policies, vary) for split, count in counts]
    if not blocks:
        raise wrong(path, "rounds", "collect nothing", "give at least one round without `reuse`")
    parent = plan.parent
    try:
        if parent is not None and (path.parent / parent).is_dir():
            parent = str(path.parent / parent)
    except OSError as error:
        raise wrong(path, "parent", f"names no folder: {error.strerror}", "check the path") from error
    about = Description(**{one.name: getattr(plan, one.name) for one in fields(Description)})
    return CollectionPlan(path, about, plan.seed, tuple(blocks), tuple(reused), parent)


def _check_axes(path: Path, where: str, tasks: dict[str, _Task]) -> None:
    """Raise where an axis is named that none of its tasks has."""
    named = {axis: [t for t, v in tasks.items() if v.vary and axis in v.vary.axes] for axis in AXES}
    for axis, of in named.items():
        if of and not any(axes_in(task, [axis]) for task in of):
            what = f"has the axis {axis!r}, which {', '.join(of)} {'does' if len(of) == 1 else 'do'} not have"
            hint = f"leave it out; it belongs to {', '.join(AXES[axis].tasks)}"
            raise wrong(path, f"{where}.vary", what, hint)


def _vary(task: str, values: _Task) -> Vary | None:
    """How the episodes of a task are varied: by those axes of its round that it has."""
    axes = () if values.vary is None else axes_in(task, values.vary.axes)
    return Vary(axes, values.vary.clean) if values.vary is not None and axes else None


def _policies(path: Path, where: str, task: str, values: _Task, networks: _Networks) -> tuple[PolicyUse, ...]:
    """Which policy plays each step of a task."""
    before = len(TASKS[task]) - 1
    if before and values.picks is None:
        raise wrong(path, f"{where}.picks", "is missing", 'name the policy of the first steps: picks = "reference"')
    last = _policy(path, f"{where}.policy", task, values.policy, networks)
    if not before or values.picks is None:
        return (last,)
    return (*(_policy(path, f"{where}.picks", task, values.picks, networks),) * before, last)


def _policy(path: Path, where: str, task: str, use: _Policy, networks: _Networks) -> PolicyUse:
    """A policy with the files that it needs for a task: relative paths start in the plan's folder."""
    try:
        spec = resolve(str(path.parent / os.path.expanduser(use.code)) if ".py" in use.code else use.code)
        found = weights_of(spec, None, task) if use.checkpoint is None else networks(use.checkpoint)
    except RemaError as error:
        message = f"{path}: {where}: {error.message}"
        raise type(error)(message, hint=error.hint, **{**error.facts, "field": where}) from error
    except OSError as error:  # of a name that no file can have
        raise wrong(path, where, f"names no file: {error.strerror}", "check the path") from error
    if found is None and spec.name in LEARNED:
        hint = 'name them: { code = "tae", checkpoint = "FOLDER" }'
        raise wrong(path, where, f"is {spec.name}, which has no networks of its own", hint)
    return PolicyUse(spec, found, use.device)


def wrong(path: Path, field: str, what: str, hint: str) -> InputError:
    """The error about one field of a plan."""
    return InputError(f"{path}: {field} {what}", hint=hint, path=str(path), field=field)
