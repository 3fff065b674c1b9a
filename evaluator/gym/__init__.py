"""Every task as a Gymnasium environment: importing this package registers them.

::

    import gymnasium
    import evaluator.gym

    environment = gymnasium.make("rema/GraspPush-v1")

or in one go, ``gymnasium.make("evaluator.gym:rema/GraspPush-v1")``. Needs Gymnasium, which is the extra ``gym``.
"""

from __future__ import annotations

from rema_data.schema import TASKS

try:
    from gymnasium.envs.registration import register, registry
except ImportError as error:
    raise ImportError('evaluator.gym needs Gymnasium, which is not installed: pip install "rema[gym]"') from error

__all__ = ["ENVIRONMENTS", "environment_id"]


def environment_id(task: str) -> str:
    """Name of the environment of a task: ``rema/GraspPush-v1`` for ``grasp_push``."""
    return f"rema/{''.join(word.capitalize() for word in task.split('_'))}-v1"


ENVIRONMENTS = {environment_id(task): task for task in TASKS}
"""Task of every environment."""

for _name, _task in ENVIRONMENTS.items():
    if _name not in registry:
        register(_name, entry_point="evaluator.gym.environment:TaskEnv", kwargs={"task": _task})
