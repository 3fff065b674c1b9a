"""An environment of LeRobot's hub: push this folder, and ``make_env("USER/NAME", trust_remote_code=True)`` plays it.

LeRobot calls the function below with `n_envs` and `use_async_envs`. It gets ``{"rema": {0: ..., 4: ...}}``: a vector
of environments a task over its validation list, where ``reset(seed=n)`` is scenario n.
"""

from evaluator.harness.poses import make_env

__all__ = ["make_env"]
