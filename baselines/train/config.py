"""What a network is trained on, and how."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Literal

from pydantic import Field, model_validator

from baselines.tae.network import Architecture
from rema_data.schema import TASKS, skill
from rema_data.validation import record

__all__ = ["TrainingConfig", "skills_of"]

Positive = Annotated[int, Field(ge=1)]
Share = Annotated[float, Field(gt=0, allow_inf_nan=False)]


@record
class TrainingConfig:
    """One training; equal configurations on equal data give equal weights on one machine, with as many threads."""

    primitive: Literal["grasp", "push"]
    tasks: Annotated[tuple[str, ...], Field(min_length=1)]  # whose steps with this primitive are used
    # only the steps of these skills; of all where it is empty. A tool pick has the skill ``grasp``
    skills: tuple[str, ...] = ()
    subset: str | None = None  # a fixed part of the training episodes of every block, such as ``10pct-r1``
    where: str | None = None  # a condition that a step meets to be used, as of ``Release.steps``; of both splits
    updates: Positive = 160_000  # steps of the optimiser
    batch_size: Positive = 8  # samples of a step, balanced over skill and success (paper: 8)
    learning_rate: Annotated[float, Field(gt=0, lt=1)] = 1e-4  # of Adam (paper: 1e-4)
    schedule: Literal["constant", "cosine"] = "constant"  # ``cosine`` lets the rate fall to nothing over the updates
    balance: Literal["exact", "average"] = "exact"  # in every minibatch, or on average as in the paper
    # draws of some skills for one of each other, such as {"grasp_push": 3}; equal where it is empty
    shares: dict[str, Share] = field(default_factory=dict)
    # of the failures of minibatches: so many are the hardest that the present weights find (baselines.train.hard)
    hard_share: Annotated[float, Field(ge=0, le=1)] = 0.0
    hard_every: Positive = 500  # updates between two looks for hard failures; the first minibatches have none
    # where a skill lacks successes, failures or steps: refuse, or use the rest
    on_empty: Literal["raise", "renormalise"] = "raise"
    rotate: bool = True  # augment grasps by rotation, where it is valid
    mirror: bool = True  # augment pushes by mirror images, where it is valid
    # of the initial weights, the draws and the augmentations; torch takes the next number, too, and none beyond 63 bits
    seed: Annotated[int, Field(ge=0, lt=2**63 - 1)] = 0
    # of what the layers compute while they learn; the weights, their sums and the validation are float32 either way.
    # bfloat16 takes half to two thirds of the time where the processor multiplies matrices of it (AMX,
    # AVX-512 BF16, or a GPU)
    precision: Literal["float32", "bfloat16"] = "float32"
    validate_every: Positive = 2_000  # updates between two validations
    validation_steps: Annotated[int, Field(ge=2)] = 1_000  # scored, half of them successes if there are as many
    architecture: Architecture = field(default_factory=Architecture)

    @model_validator(mode="after")
    def _has_steps(self) -> TrainingConfig:
        if unknown := [task for task in self.tasks if task not in TASKS]:
            raise ValueError(f"has the unknown task {unknown[0]!r}; tasks: {', '.join(TASKS)}")
        known = skills_of(self.primitive, self.tasks)
        wrong = ", ".join(sorted(set(self.skills) - set(known)))
        if wrong or not known:
            steps = f"{self.primitive} step of the skill {wrong or 'any'}"
            raise ValueError(f"has no {steps} in {', '.join(self.tasks)}; skills: {', '.join(known) or 'none'}")
        if unshared := sorted(set(self.shares) - set(self.learned_skills)):
            raise ValueError(f"shares names {unshared[0]!r}; skills that are learned: {', '.join(self.learned_skills)}")
        return self

    @property
    def learned_skills(self) -> tuple[str, ...]:
        """The skills that the steps exercise, in the order of the tasks."""
        return tuple(name for name in skills_of(self.primitive, self.tasks) if not self.skills or name in self.skills)


def skills_of(primitive: str, tasks: tuple[str, ...]) -> tuple[str, ...]:
    """Skills that the steps of some tasks with one primitive exercise, in the order of the tasks."""
    found = {skill(kind) for task in tasks for kind in TASKS[task] if kind.primitive == primitive}
    return tuple(name for name in TASKS if name in found)
