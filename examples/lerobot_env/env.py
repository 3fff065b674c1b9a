"""An environment of LeRobot's hub: push this folder, and ``make_env("USER/NAME", trust_remote_code=True)`` plays it.

LeRobot calls the function below with ``n_envs`` and ``use_async_envs``, and gets ``{"rema": {0: ..., 4: ...}}``: vectors
of environments of the five tasks over their validation lists, where ``reset(seed=n)`` is scenario n.
"""

from evaluator.harness.poses import make_env

__all__ = ["make_env"]
