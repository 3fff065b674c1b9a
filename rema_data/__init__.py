"""The ReMa dataset: records, grid and errors shared by the world, the evaluator and the baselines.

::

    release = rema_data.load("rema-mini")
    dataset = release.steps(tasks=["grasp"], split="train")
    sampler = rema_data.BalancedSampler(dataset, batch_size=8, by=("task", "success"), seed=0)
    loader = torch.utils.data.DataLoader(dataset, batch_sampler=sampler, num_workers=2)

The names below are imported when they are first used: ``import rema_data`` alone loads neither torch nor pandas.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rema_data import environment

if TYPE_CHECKING:
    from rema_data import download
    from rema_data.loader.arrays import FloatArrays, StepArrays
    from rema_data.loader.batch import FloatBatch, StepBatch
    from rema_data.loader.dataset import StepDataset
    from rema_data.loader.release import Release, load
    from rema_data.samplers import BalancedSampler

__all__ = [
    "BalancedSampler",
    "FloatArrays",
    "FloatBatch",
    "Release",
    "StepArrays",
    "StepBatch",
    "StepDataset",
    "download",
    "load",
]

_HOMES = {
    "BalancedSampler": "rema_data.samplers",
    "FloatArrays": "rema_data.loader.arrays",
    "FloatBatch": "rema_data.loader.batch",
    "Release": "rema_data.loader.release",
    "StepArrays": "rema_data.loader.arrays",
    "StepBatch": "rema_data.loader.batch",
    "StepDataset": "rema_data.loader.dataset",
    "download": "rema_data.download",
    "load": "rema_data.loader.release",
}


environment.pin()


def __getattr__(name: str) -> Any:
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'rema_data' has no attribute {name!r}")
    module = import_module(home)
    value = module if home == f"rema_data.{name}" else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
