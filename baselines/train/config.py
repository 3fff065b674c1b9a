"""What a network is trained on, and how."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Literal

from baselines.tae.network import Architecture
from rema_data.errors import InputError
from rema_data.schema import TASKS, Primitive, check_task, skill

__all__ = ["TrainingConfig", "skills_of"]

_CHOICES = {
    "primitive": tuple(item.value for item in Primitive),
    "schedule": ("constant", "cosine"),
    "balance": ("exact", "average"),
    "on_empty": ("raise", "renormalise"),
}
_LEAST = {"updates": 1, "batch_size": 1, "validate_every": 1, "validation_steps": 2, "seed": 0}
_MOST_SEED = 2**63 - 2
"""torch takes the next number, too, and none beyond 63 bits."""


@dataclass(frozen=True, slots=True)
class TrainingConfig:
    """One training; equal configurations on equal data give equal weights on one machine, with as many threads.

    Attributes
    ----------
    primitive : {"grasp", "push"}
    tasks : tuple of str
        Whose steps with this primitive are used.
    skills : tuple of str
        Of these steps, those of some skills only; all where it is empty. A tool pick has the skill ``grasp``.
    updates : int
        Steps of the optimiser.
    batch_size : int
        Samples of a step, balanced over skill and success (paper: 8).
    learning_rate : float
        Of Adam (paper: 1e-4).
    schedule : {"constant", "cosine"}
        ``cosine`` lets the rate fall to nothing over the updates.
    balance : {"exact", "average"}
        In every minibatch, or on average as in the paper.
    on_empty : {"raise", "renormalise"}
        What to do where a skill has no success, no failure or no step at all: refuse, or go on with what there is.
    rotate, mirror : bool
        Augmentations beside the translation, each where it is valid: rotation of grasps, mirror images of pushes.
    seed : int
        Of the initial weights, the draws and the augmentations.
    validate_every : int
        Updates between two validations.
    validation_steps : int
        Steps of the validation split that are scored, half of them successes where there are as many.
    architecture : Architecture
    """

    primitive: str
    tasks: tuple[str, ...]
    skills: tuple[str, ...] = ()
    updates: int = 160_000
    batch_size: int = 8
    learning_rate: float = 1e-4
    schedule: Literal["constant", "cosine"] = "constant"
    balance: Literal["exact", "average"] = "exact"
    on_empty: Literal["raise", "renormalise"] = "raise"
    rotate: bool = True
    mirror: bool = True
    seed: int = 0
    validate_every: int = 2_000
    validation_steps: int = 1_000
    architecture: Architecture = field(default_factory=Architecture)

    def __post_init__(self) -> None:
        for name, allowed in _CHOICES.items():
            if not isinstance(getattr(self, name), str) or getattr(self, name) not in allowed:
                raise InputError(f"{name} = {getattr(self, name)!r} is unknown", hint=f"use {' or '.join(allowed)}")
        for name, least in _LEAST.items():
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise InputError(f"{name} = {value!r} is not possible", hint=f"give a whole number from {least} on")
        if self.seed > _MOST_SEED:
            raise InputError(f"seed = {self.seed} is not possible", hint=f"give one up to {_MOST_SEED}")
        for name in ("rotate", "mirror"):
            if not isinstance(getattr(self, name), bool):
                raise InputError(f"{name} = {getattr(self, name)!r} is not possible", hint="write true or false")
        if not isinstance(self.learning_rate, int | float) or not 0 < self.learning_rate < 1:
            raise InputError(f"learning_rate = {self.learning_rate!r} is not possible", hint="give one such as 1e-4")
        if not self.tasks:
            raise InputError("a training needs tasks", hint=f"choose some of: {', '.join(TASKS)}")
        for task in self.tasks:
            check_task(task)
        known = skills_of(self.primitive, self.tasks)
        wrong = sorted(set(self.skills) - set(known))
        if wrong or not known:
            raise InputError(
                f"{', '.join(self.tasks)} have no {self.primitive} step of the skill {', '.join(wrong) or 'any'}",
                hint=f"skills: {', '.join(known) or 'none'}",
            )

    @property
    def learned_skills(self) -> tuple[str, ...]:
        """The skills that the steps exercise, in the order of the tasks."""
        return tuple(name for name in skills_of(self.primitive, self.tasks) if not self.skills or name in self.skills)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> TrainingConfig:
        """Inverse of ``to_dict``; what is left out has its default.

        Raises
        ------
        InputError
            A field is unknown, missing, or its value is not possible.
        """
        unknown = sorted(set(values) - {item.name for item in fields(cls)})
        if unknown:
            names = ", ".join(item.name for item in fields(cls))
            raise InputError(f"a training has no {', '.join(unknown)}", hint=f"it has: {names}")
        missing = [name for name in ("primitive", "tasks") if name not in values]
        if missing:
            raise InputError(f"a training needs {' and '.join(missing)}", hint='write primitive = "grasp"')
        made = dict(values)
        for name in ("tasks", "skills"):
            if name in made:
                if not isinstance(made[name], list | tuple) or not all(isinstance(one, str) for one in made[name]):
                    raise InputError(f"{name} = {made[name]!r} is no list of names", hint=f'write {name} = ["grasp"]')
                made[name] = tuple(made[name])
        shape = made.get("architecture", Architecture())
        if isinstance(shape, Mapping):
            made["architecture"] = _architecture(shape)
        elif not isinstance(shape, Architecture):
            raise InputError(
                f"architecture = {shape!r} is no table", hint="write architecture = { width = 64 }, or leave it out"
            )
        return cls(**made)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, ready for JSON."""
        return {**asdict(self), "tasks": list(self.tasks), "skills": list(self.skills)}


def _architecture(values: Mapping[str, Any]) -> Architecture:
    """As somebody wrote it; what comes out of a card has been one before."""
    known = {item.name: type(item.default) for item in fields(Architecture)}
    for name, value in values.items():
        if name not in known:
            raise InputError(f"architecture.{name} is unknown", hint=f"it has: {', '.join(known)}")
        if type(value) is not known[name]:  # 4.0 and True are no 4
            raise InputError(
                f"architecture.{name} = {value!r} is no {known[name].__name__}", hint="see docs/network.md"
            )
    return Architecture(**values)


def skills_of(primitive: str, tasks: tuple[str, ...]) -> tuple[str, ...]:
    """Skills that the steps of some tasks with one primitive exercise, in the order of the tasks."""
    found = {skill(kind) for task in tasks for kind in TASKS[task] if kind.primitive == primitive}
    return tuple(name for name in TASKS if name in found)
