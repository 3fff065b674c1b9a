"""Inference speed: decisions a second of the learned policy, against all rotations evaluated without any sharing.

    python benchmarks/infer.py --checkpoint releases/checkpoints/rema-v0/joint
    python benchmarks/infer.py --checkpoint FOLDER --scenarios 1000 --runtimes

Plain: every scene with every angle goes through the whole network, as it was trained, 16 pairs at a time. Both score
the same scenarios of the validation lists; the share of equal decisions (the same best valid action) is counted.
``--runtimes`` also runs the decoder, most of the work, in torch.compile, ONNX Runtime and OpenVINO where they are
installed (pip install onnx onnxscript onnxruntime openvino).
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import torch
from rich.table import Table

from baselines.tae.checkpoint import load_checkpoint
from baselines.tae.network import TaeNetwork
from baselines.tae.rotation import turn_end_effector
from baselines.tae.scoring import folded
from baselines.tae_policy import TIE, TaePolicy
from benchmarks.results import finish, parser, target
from evaluator.policy import ObservationBatch
from evaluator.scenarios import load_list
from evaluator.sim.observation import observe
from evaluator.sim.reach import valid_actions
from rema_data.schema import TASKS

BATCH = 16
WANTED_RATIO, WANTED_EQUAL = 2.0, 0.999


def questions(task: str, count: int) -> list[ObservationBatch]:
    """The last step of the first scenarios of the task's validation list."""
    situations = [scenario.last_situation() for scenario in load_list(task, "val").scenarios[:count]]
    step = len(TASKS[task]) - 1
    kind, valid = TASKS[task][step], valid_actions(task, step)
    made = []
    for start in range(0, count, BATCH):
        seen = [observe(situation) for situation in situations[start : start + BATCH]]
        made.append(
            ObservationBatch(
                np.stack([one.scene_m() for one in seen]),
                np.stack([one.end_effector() for one in seen]),
                kind.primitive.value,
                kind.embodiment.value,
                task,
                step,
                np.broadcast_to(valid, (len(seen), *valid.shape)),
            )
        )
    return made


@torch.inference_mode()
def plain(network: TaeNetwork, question: ObservationBatch, angles: int) -> np.ndarray:
    """Best valid actions with every angle computed anew."""
    actions = []
    for n in range(len(question)):
        hand = torch.from_numpy(np.ascontiguousarray(np.moveaxis(question.end_effector[n], -1, 0)))[None]
        turned = turn_end_effector(hand.expand(angles, -1, -1, -1), torch.arange(angles))
        scene = torch.from_numpy(question.scene[n])[None, None].expand(angles, -1, -1, -1)
        logits = network(scene.contiguous(), turned)
        scores = (logits[:, 1] - logits[:, 0]).movedim(0, -1).numpy()
        masked = np.where(question.valid[n, ..., :angles], scores, -np.inf).reshape(-1)
        cell, k = divmod(int((masked >= masked.max() - TIE).argmax()), angles)
        actions.append(cell * 16 + k)
    return np.array(actions)


def measure(checkpoint: Path, task: str, scenarios: int, repeats: int) -> dict[str, Any]:
    """Decisions a second of both ways, in turns, and the share of equal ones."""
    policy, asked = TaePolicy(checkpoint), questions(task, scenarios)
    primitive = asked[0].primitive
    network, _ = load_checkpoint(checkpoint / f"{primitive}.safetensors")
    angles = 8 if asked[0].embodiment in ("sticks", "pinched") else 16
    ours = np.concatenate([policy.act(question) for question in asked])
    theirs = np.concatenate([plain(network, question, angles) for question in asked])
    speeds: dict[str, list[float]] = {"ours": [], "plain": []}
    for _ in range(repeats):
        for name, act in (("ours", policy.act), ("plain", lambda q: plain(network, q, angles))):
            began = time.perf_counter()
            act(asked[0])
            speeds[name].append(len(asked[0]) / (time.perf_counter() - began))
    ratio = median(a / b for a, b in zip(*speeds.values(), strict=True))
    return {"task": task, "speeds": speeds, "ratio": ratio, "equal": int((ours == theirs).sum()), "of": len(ours)}


def runtimes(network: TaeNetwork, folder: Path, repeats: int) -> dict[str, tuple[float, float]]:
    """Milliseconds of the decoder for 16 angles of a scene by runtime, and the largest difference from eager torch."""
    decoder = folded(network).placed("cpu").decoder
    given = torch.rand(16, network.architecture.width // 4, 16, 16, generator=torch.Generator().manual_seed(0))
    ways: dict[str, Callable[[], Any]] = {}
    with torch.inference_mode():
        wanted = decoder(given)
        ways["torch, eager"] = lambda: decoder(given)
        compiled = torch.compile(decoder)
        ways["torch.compile"] = lambda: compiled(given)
        path = folder / "decoder.onnx"
        try:
            torch.onnx.export(decoder, (given,), str(path), input_names=["x"], output_names=["y"], dynamo=True)
            import onnxruntime

            session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
            ways["ONNX Runtime"] = lambda: session.run(None, {"x": given.numpy()})[0]
        except ImportError as error:
            print(f"without ONNX Runtime: {error}", file=sys.stderr)
        try:
            import openvino

            model = openvino.compile_model(openvino.convert_model(decoder, example_input=given), "CPU")
            ways["OpenVINO"] = lambda: model(given.numpy())[0]
        except ImportError as error:
            print(f"without OpenVINO: {error}", file=sys.stderr)
        found = {}
        for name, way in ways.items():
            gap = float((torch.as_tensor(way()) - wanted).abs().max())
            times = []
            for _ in range(repeats):
                began = time.perf_counter()
                way()
                times.append(1e3 * (time.perf_counter() - began))
            found[name] = (median(times), gap)
    return found


def main() -> int:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--checkpoint", type=Path, required=True, help="folder with grasp and push")
    options.add_argument("--tasks", default="grasp,push,grasp_push,grasp_grasp")
    options.add_argument("--scenarios", type=int, default=320, help="whose decisions are compared (default 320)")
    options.add_argument("--repeats", type=int, default=5)
    options.add_argument("--runtimes", action="store_true", help="also try other runtimes")
    arguments = options.parse_args()
    found = [
        measure(arguments.checkpoint, task, arguments.scenarios, arguments.repeats)
        for task in arguments.tasks.split(",")
    ]
    table = Table("task", "ours, decisions/s", "plain, decisions/s", "times", "equal decisions", title="inference")
    targets = []
    for row in found:
        ours, theirs = (median(row["speeds"][name]) for name in ("ours", "plain"))
        share = row["equal"] / row["of"]
        table.add_row(
            row["task"], f"{ours:.1f}", f"{theirs:.1f}", f"{row['ratio']:.1f}", f"{row['equal']} of {row['of']}"
        )
        targets.append(
            target(f"{row['task']}: plain", ">= 2 times", f"{row['ratio']:.1f}", row["ratio"] >= WANTED_RATIO)
        )
        targets.append(target(f"{row['task']}: equal", ">= 99.9%", f"{share:.2%}", share >= WANTED_EQUAL))
    tables, numbers = [table], {"found": found}
    if arguments.runtimes:
        network, _ = load_checkpoint(next(arguments.checkpoint.glob("*.safetensors")))
        with tempfile.TemporaryDirectory() as name:
            measured = runtimes(network, Path(name), 20)
        other = Table("runtime", "ms", "largest difference of a logit", title="the decoder, 16 angles of a scene")
        for name, (ms, gap) in measured.items():
            other.add_row(name, f"{ms:.1f}", f"{gap:.1g}")
        tables.append(other)
        numbers["runtimes"] = measured
    notes = [f"{torch.get_num_threads()} threads; torch {torch.__version__}."]
    return finish(arguments, "infer", tables, targets, notes, numbers)


if __name__ == "__main__":
    sys.exit(main())
