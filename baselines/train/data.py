"""From a release to batches for the network: selection, leakage check, balance, augmentation."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from baselines.tae.rotation import turn_end_effector
from baselines.train.config import TrainingConfig
from rema_data.augment import Augment
from rema_data.errors import InputError, IntegrityError
from rema_data.grid import ANGLES
from rema_data.loader.batch import StepBatch
from rema_data.loader.dataset import StepDataset
from rema_data.loader.release import Release
from rema_data.samplers import BalancedSampler
from rema_data.verify.leakage import frozen_scenes, scene_keys

__all__ = ["Samples", "TrainingData", "open_data", "prepared"]


class Samples(NamedTuple):
    """What the network is asked, and the answer."""

    scene: Tensor  # float32 (N, 1, 64, 64)
    end_effector: Tensor  # float32 (N, 4, 112, 112), turned to the angle of the action
    pixel: Tensor  # int64 (N,), place of the action: row * 64 + column
    success: Tensor  # bool (N,)


@dataclass(frozen=True, slots=True)
class TrainingData:
    """Both splits of what a configuration selects."""

    train: StepDataset
    validation: StepDataset  # at most ``validation_steps``; of every skill half successes where there are enough
    sampler: BalancedSampler  # of ``train``, by skill and success

    def batches(self, replaced: Callable[[Sequence[int]], Sequence[int]] | None = None) -> Iterator[StepBatch]:
        """Training batches without an end, from where the sampler stands; ``replaced`` may change their rows."""
        while True:
            for rows in self.sampler:
                batch = self.train.__getitems__(rows if replaced is None else replaced(rows))
                assert isinstance(batch, StepBatch)
                yield batch


def open_data(release: Release, config: TrainingConfig) -> TrainingData:
    """Select and check the data of a training.

    Raises InputError where the release lacks a task or a skill, or a skill lacks successes or failures, IntegrityError
    where a scene is one of the frozen test scenarios, and MissingFileError where a block is not on this machine.
    """
    refuse_test_scenes(release, config.tasks)
    skills = config.learned_skills
    if config.on_empty == "renormalise":
        skills = tuple(name for name in skills if name in set(release.cache.categories["skill"]))
    train, val = (
        release.steps(
            tasks=config.tasks, split=split, which="all", skills=skills, subset=config.subset, where=config.where
        )
        for split in ("train", "val")
    )
    _require_labels(release.name, "train on", train, skills if config.on_empty == "raise" else ())
    present = set(train.table["skill"])
    if config.on_empty == "raise":
        _require_labels(release.name, "validate with", val, skills)
    sampler = BalancedSampler(
        train,
        batch_size=config.batch_size,
        by=("skill", "success"),
        mode=config.balance,
        on_empty=config.on_empty,
        seed=config.seed,
        rotate=True,
        rank=0,
        world_size=1,
        shares={name: share for name, share in config.shares.items() if name in present},
    )
    return TrainingData(train, val.select(_balanced(val, config.validation_steps)), sampler)


def _require_labels(release: str, purpose: str, steps: StepDataset, skills: Iterable[str]) -> None:
    """Raise where there are no successes or no failures: in all steps, or in those of one of the skills."""
    table = steps.table
    for name in (None, *skills):
        labels = table["success"] if name is None else table["success"][table["skill"] == name]
        if set(labels) != {True, False}:
            missing = "success" if not labels.any() else "failure"
            what = "" if name is None else f" of the skill {name}"
            raise InputError(
                f"release {release} has no {missing}{what} to {purpose}",
                hint="collect more of it, leave its task out, or go on with what there is: on_empty = renormalise",
                skill=name,
            )


def _balanced(val: StepDataset, limit: int) -> npt.NDArray[np.int64]:
    """Rows of the validation split, evenly spread: of every skill as many successes as failures where possible."""
    groups = val.table.reset_index().groupby(["skill", "success"], observed=True)["index"]
    share = max(1, limit // groups.ngroups)
    chosen = []
    for _, members in groups:
        rows = members.to_numpy()
        chosen.append(rows[np.linspace(0, len(rows) - 1, min(share, len(rows))).astype(int)])
    return np.sort(np.concatenate(chosen))


def refuse_test_scenes(release: Release, tasks: tuple[str, ...]) -> None:
    """Raise an IntegrityError where a frozen list has a scene of the release, MissingFileError without lists."""
    frozen = frozen_scenes()
    for block in release.blocks:
        if block.key.task not in tasks:
            continue
        for row, key in enumerate(scene_keys(release.folder.block(block).steps(), "target")):
            if key in frozen:
                raise IntegrityError(
                    f"step {row} of {block.key.path} in {release.name} is the scenario {frozen[key]}, which is kept "
                    "for evaluation and may not be trained on",
                    hint=f"do not use this release; look at all of it: {release.folder.repair.verify}",
                    scenario=frozen[key],
                )


def prepared(batch: StepBatch, augment: Augment | None, random: torch.Generator, device: torch.device) -> Samples:
    """A batch as the network takes it, augmented where ``augment`` is given."""
    if augment is not None:
        batch = augment(batch, random)
    maps = batch.to(device).float()
    cell, k = maps.action // ANGLES, maps.action % ANGLES
    turned = turn_end_effector(maps.end_effector, k)
    fast = torch.channels_last
    return Samples(maps.scene.contiguous(memory_format=fast), turned.contiguous(memory_format=fast), cell, maps.success)
