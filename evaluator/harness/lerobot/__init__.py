r"""The tasks as a kind of environment of LeRobot: importing this package registers ``--env.type=rema``.

::

    lerobot-eval --env.discover_packages_path=evaluator.harness.lerobot --env.type=rema --env.task=grasp_push \
        --policy.path=outputs/train/checkpoints/last/pretrained_model --eval.n_episodes=200 --seed=0

Needs LeRobot 0.6 or newer. A policy that was trained on ``rema export --format lerobot`` needs nothing between.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig

from evaluator.harness.poses import make_env
from rema_data.grid import EE_PIXELS, SCENE_PIXELS

__all__ = ["RemaConfig"]


def _features() -> dict[str, PolicyFeature]:
    """Maps are states and no images: LeRobot would want bytes of three colours, or take heights for millimetres."""
    return {
        "action": PolicyFeature(FeatureType.ACTION, (4,)),
        "scene": PolicyFeature(FeatureType.STATE, (1, SCENE_PIXELS, SCENE_PIXELS)),
        "end_effector": PolicyFeature(FeatureType.STATE, (4, EE_PIXELS, EE_PIXELS)),
    }


@EnvConfig.register_subclass("rema")
@dataclass
class RemaConfig(EnvConfig):  # type: ignore[misc]
    """Which scenarios are played: those of one task, or of all where ``task`` is None, of a frozen list.

    Attributes
    ----------
    task : str, optional
    split : {"val", "test"}
    protocol : {"conditional", "end-to-end"}
    """

    task: str | None = None
    split: str = "val"
    protocol: str = "conditional"
    fps: int = 1
    features: dict[str, PolicyFeature] = field(default_factory=_features)
    features_map: dict[str, str] = field(
        default_factory=lambda: {
            "action": "action",
            "scene": "observation.scene",
            "end_effector": "observation.end_effector",
        }
    )

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Nothing: the environments are not made by name."""
        return {}

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, Any]]:
        """Environments by suite and number of the task; see ``evaluator.harness.poses.make_env``."""
        return make_env(n_envs, use_async_envs, self)
