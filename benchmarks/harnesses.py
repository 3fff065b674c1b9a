"""Has a policy the same outcomes in another harness as in ``rema evaluate``? Every scenario is compared.

    python benchmarks/harnesses.py --harness lerobot --python lerobot/bin/python
    python benchmarks/harnesses.py --harness vla-eval --python vla/bin/python --task grasp_push --scenarios 20

``examples/my_policy.py`` plays the first scenarios of the validation lists in both. The harness runs them with its own
runner in an environment of its own, in which rema is installed too. Exits with 6 if an outcome differs.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from rich.table import Table

from benchmarks.foreign import THERE
from benchmarks.results import ROOT, finish, parser, target
from evaluator import evaluate, read_run
from evaluator.policy import ObservationBatch
from evaluator.sim.reach import valid_actions
from rema_data import grid
from rema_data.schema import TASKS

POLICY = ROOT / "examples" / "my_policy.py"
INSTALL = {
    "lerobot": "python3.12 -m venv lerobot && lerobot/bin/pip install 'lerobot[dataset]>=0.6' -e '.[gym]'",
    "vla-eval": "python -m venv vla && vla/bin/pip install 'vla-eval>=0.8' -e '.[gym]'",
    "inspect-robots": "python -m venv inspect && inspect/bin/pip install 'inspect-robots>=0.60' -e '.[gym]'",
}
VECTOR = 2
"""Environments of LeRobot that step together."""

Answer = Callable[[Any, Any], tuple[float, float, float]]
"""Pose (x m, y m, yaw rad) for the maps of an observation, planes first."""


def answer_of(task: str) -> Answer:
    """The policy of the examples at the last step of a task."""
    spec = importlib.util.spec_from_file_location("my_policy", POLICY)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    policy = module.Policy(None, "cpu")
    step = len(TASKS[task]) - 1
    kind, valid = TASKS[task][step], valid_actions(task, step)

    def answer(scene: Any, end_effector: Any) -> tuple[float, float, float]:
        maps = np.asarray(scene, np.float32), np.moveaxis(np.asarray(end_effector, np.float32), 0, -1)[None]
        names = kind.primitive.value, kind.embodiment.value, task
        ((i, j, k),) = policy.act(ObservationBatch(*maps, *names, step, valid[None]))
        return grid.to_world(int(grid.encode(i, j, k)))

    return answer


def scaled(pose: tuple[float, float, float]) -> Any:
    """A pose as an action of an export, float32 (4,)."""
    x_m, y_m, yaw_rad = pose
    half = grid.SCENE_HALF_M
    return np.array([x_m / half, y_m / half, np.cos(yaw_rad), np.sin(yaw_rad)], np.float32)


def in_lerobot(task: str, count: int) -> list[bool]:
    """Through ``make_env`` of LeRobot, as an environment of its hub, and its ``eval_policy``."""
    from dataclasses import dataclass

    import torch
    from lerobot.configs import PreTrainedConfig
    from lerobot.configs.parser import load_plugin
    from lerobot.envs import factory, make_env
    from lerobot.envs.configs import EnvConfig
    from lerobot.envs.utils import env_to_policy_features
    from lerobot.policies.pretrained import PreTrainedPolicy
    from lerobot.scripts.lerobot_eval import eval_policy

    @dataclass
    class Config(PreTrainedConfig):
        observation_delta_indices = action_delta_indices = reward_delta_indices = None

        def get_optimizer_preset(self) -> Any: ...
        def get_scheduler_preset(self) -> Any: ...
        def validate_features(self) -> None: ...

    answer = answer_of(task)

    class Policy(PreTrainedPolicy):
        config_class, name = Config, "rema_example"

        def select_action(self, batch: Mapping[str, Any]) -> Any:
            maps = zip(batch["observation.scene"], batch["observation.end_effector"], strict=True)
            return torch.from_numpy(np.stack([scaled(answer(*(map_.numpy() for map_ in pair))) for pair in maps]))

        def reset(self) -> None: ...
        def forward(self, batch: Any) -> Any: ...
        def get_optim_params(self) -> Any: ...
        def predict_action_chunk(self, batch: Any) -> Any: ...

    load_plugin("evaluator.harness.lerobot")  # what --env.discover_packages_path does
    config = EnvConfig.get_choice_class("rema")(task=task)
    config.hub_path = "rema/tasks"
    features = env_to_policy_features(config)
    assert set(features) == {"action", "observation.scene", "observation.end_effector"}, features
    # The hub is not asked: its file is the one in this repository.
    file = ROOT / "examples" / "lerobot_env" / "env.py"
    factory._download_hub_file = lambda name, *_: (name, file.name, str(file), "main")
    made = make_env("rema/tasks", n_envs=VECTOR, trust_remote_code=True)["rema"]
    (vector,) = [one for one in made.values() if one.call("task")[0] == task]
    other = config.create_envs(VECTOR)["rema"]  # what --env.type=rema makes
    assert [one.single_observation_space for one in other.values()] == [vector.single_observation_space]

    def as_it_is(value: Any) -> Any:
        return value

    policy = Policy(Config(device="cpu"))
    found = eval_policy(vector, policy, as_it_is, as_it_is, as_it_is, as_it_is, n_episodes=count, start_seed=0)
    for one in (*made.values(), *other.values()):
        one.close()
    return [bool(episode["success"]) for episode in found["per_episode"]]


def in_vla_eval(task: str, count: int) -> list[bool]:
    """Through ``vla_eval.evaluate``: its orchestrator, and a model server that it reaches by a socket."""
    import vla_eval
    from vla_eval.model_servers.predict import PredictModelServer

    from evaluator.harness.vla_eval import RemaBenchmark

    answer = answer_of(task)

    class Server(PredictModelServer):
        def predict(self, obs: dict[str, Any], ctx: Any) -> dict[str, Any]:
            return {"actions": scaled(answer(obs["scene"], obs["end_effector"]))}

        def get_action_spec(self) -> Any:
            return RemaBenchmark().get_action_spec()

        def get_observation_spec(self) -> Any:
            return RemaBenchmark().get_observation_spec()

    name = "evaluator.harness.vla_eval:RemaBenchmark"
    entry = {"benchmark": name, "episodes_per_task": count, "params": {"tasks": [task]}}
    with tempfile.TemporaryDirectory() as folder:
        (found,) = vla_eval.evaluate(Server(), {"benchmarks": [entry]}, output_dir=folder, docker=False)
    episodes = sorted(found["tasks"][0]["episodes"], key=lambda episode: episode["episode_id"])
    return [bool(episode["metrics"]["success"]) for episode in episodes]


def in_inspect_robots(task: str, count: int) -> list[bool]:
    """Through ``inspect_robots.eval``, with the task and the embodiment that it finds by name."""
    import inspect_robots
    from inspect_robots.policy import PolicyBase, PolicyInfo
    from inspect_robots.registry import resolve
    from inspect_robots.types import Action, ActionChunk

    embodiment, answer = resolve("embodiment", "rema"), answer_of(task)

    class Policy(PolicyBase):
        info = PolicyInfo("my_policy", embodiment.info.action_space, embodiment.info.observation_space)

        def act(self, observation: Any) -> ActionChunk:
            x_m, y_m, yaw_rad = answer(observation.state["scene"], observation.state["end_effector"])
            return ActionChunk([Action(np.array([x_m, y_m, (yaw_rad + np.pi) % (2 * np.pi) - np.pi]))])

    scenes = resolve("task", "rema", task=task, scenes=count)
    with tempfile.TemporaryDirectory() as folder:
        (log,) = inspect_robots.eval(scenes, Policy(), embodiment, log_dir=folder)
    embodiment.close()
    return [bool(sample.epochs[0]["success_at_end"]) for sample in log.samples]


HARNESSES: dict[str, Callable[[str, int], list[bool]]] = {
    "lerobot": in_lerobot,
    "vla-eval": in_vla_eval,
    "inspect-robots": in_inspect_robots,
}


def outcomes_here(task: str, scenarios: int, folder: Path) -> list[bool]:
    """Successes of the scenarios that can be played, in their order."""
    evaluate(POLICY, task=task, episodes=scenarios, split="val", engine="inline", output=folder / task)
    return [row["success"] for row in read_run(folder / task).measured]


def main() -> int:
    """Play, compare and print; or play in the other environment."""
    if sys.argv[1:2] == [THERE]:
        harness, task, count = sys.argv[2], sys.argv[3], int(sys.argv[4])
        start = time.perf_counter()
        found = HARNESSES[harness](task, count)
        seen = {"successes": found, "seconds": time.perf_counter() - start, "library": f"{harness} {version(harness)}"}
        Path(sys.argv[5]).write_text(json.dumps(seen))
        return 0
    options = parser(__doc__)
    options.add_argument("--harness", required=True, choices=list(HARNESSES))
    options.add_argument("--task", action="append", choices=list(TASKS), help="only this one (repeatable)")
    options.add_argument("--scenarios", type=int, default=50, help="of each task (default 50)")
    options.add_argument("--python", default=sys.executable, help="of the environment with the harness and rema")
    arguments = options.parse_args()
    table = Table("task", "scenarios", "successes", "different", "seconds", title=f"{arguments.harness}, played")
    for column in table.columns[1:]:
        column.justify = "right"
    rows, library = [], ""
    with tempfile.TemporaryDirectory() as temporary:
        for task in arguments.task or TASKS:
            wanted = outcomes_here(task, arguments.scenarios, Path(temporary))
            file = Path(temporary) / "seen.json"
            words = [THERE, arguments.harness, task, str(len(wanted)), str(file)]
            done = subprocess.run([arguments.python, __file__, *words], check=False, capture_output=True, text=True)
            if done.returncode:
                sys.exit(f"{done.stderr}\nthe tasks cannot be played there; to install: {INSTALL[arguments.harness]}")
            seen = json.loads(file.read_text())
            library = seen["library"]
            different = sum(one != other for one, other in zip(seen["successes"], wanted, strict=True))
            rows.append({"task": task, "scenarios": len(wanted), "successes": sum(wanted), "different": different})
            shown = [str(rows[-1][key]) for key in ("scenarios", "successes", "different")]
            table.add_row(task, *shown, f"{seen['seconds']:.0f}")
    wrong = sum(row["different"] for row in rows)
    targets = [target("scenarios with another outcome", "0", str(wrong), not wrong)]
    name = f"harness_{arguments.harness.replace('-', '_')}"
    return finish(arguments, name, [table], targets, [f"played by {library}"], {"rows": rows}, mismatch=bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
