"""Inference speed: decisions a second of the learned policy, against all rotations evaluated without any sharing.

    python benchmarks/infer.py --checkpoint releases/checkpoints/rema-v1/joint
    python benchmarks/infer.py --checkpoint FOLDER --scenarios 100 --runtimes

Plain: every scene with every angle goes through the whole network, as it was trained, 16 pairs at a time. All score
the same scenarios of the validation lists; the share of equal decisions (the same best valid action) is counted, and
the others are named. Ours is timed in torch, also with whole end-effector maps, and in OpenVINO where it is installed;
where the processor multiplies matrices of bfloat16, also without the first look in these, whose errors are measured at
the best action of each angle.
``--runtimes`` also runs the decoder, most of the work, in torch.compile, ONNX Runtime and OpenVINO where they are
installed (pip install onnx onnxscript onnxruntime openvino).
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
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
from baselines.tae.scoring import _MARGIN, _RELATIVE_MARGIN, Scorer, folded, multiplies_bfloat16
from baselines.tae_policy import TIE, TaePolicy
from benchmarks.results import finish, parser, target
from evaluator.policy import ObservationBatch
from evaluator.scenarios import load_list
from evaluator.sim.observation import observe
from evaluator.sim.reach import valid_actions
from rema_data.schema import TASKS

BATCH = 16
TIMED = 4
"""Batches that are timed."""
SHOWN = 5
"""Other decisions that are printed of every way and task; the result file has all."""
WANTED_RATIO, WANTED_EQUAL = 2.0, 0.999


def questions(task: str, count: int, split: str = "val") -> list[ObservationBatch]:
    """The last step of the first scenarios of one of the task's lists."""
    situations = [scenario.last_situation() for scenario in load_list(task, split).scenarios[:count]]
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
    """Decisions a second of every way, in turns, and the scenarios on which ours differ from the plain one."""
    asked = questions(task, scenarios)
    network, _ = load_checkpoint(checkpoint / f"{asked[0].primitive}.safetensors")
    angles = 8 if asked[0].embodiment in ("sticks", "pinched") else 16
    ways: dict[str, Callable[[ObservationBatch], np.ndarray]] = {
        "plain": lambda question: plain(network, question, angles),
        "ours": TaePolicy(checkpoint).act,
        "ours, whole maps": with_whole_maps(TaePolicy(checkpoint)).act,
    }
    if multiplies_bfloat16():
        ways["ours, no first look"] = without_look(TaePolicy(checkpoint)).act
    if find_spec("openvino") is not None:
        ways["ours, OpenVINO"] = TaePolicy(checkpoint, "openvino").act
    decided = {name: np.concatenate([act(question) for question in asked]) for name, act in ways.items()}
    speeds: dict[str, list[float]] = {name: [] for name in ways}
    some = asked[:TIMED]
    for _ in range(repeats):
        for name, act in ways.items():
            began = time.perf_counter()
            for question in some:
                act(question)
            speeds[name].append(sum(map(len, some)) / (time.perf_counter() - began))
    rows = {}
    for name in ways:
        if name != "plain":
            wrong = np.flatnonzero(decided[name] != decided["plain"])
            rows[name] = {
                "times": median(a / b for a, b in zip(speeds[name], speeds["plain"], strict=True)),
                "equal": len(decided[name]) - len(wrong),
                "others": [[int(n), int(decided["plain"][n]), int(decided[name][n])] for n in wrong],
            }
    looked = look_errors(network, asked, angles) if multiplies_bfloat16() else None
    return {"task": task, "of": scenarios, "speeds": speeds, "ways": rows, "look": looked}


def without_look(policy: TaePolicy) -> TaePolicy:
    """The same policy, whose scorers compute every angle in float32."""
    for scorer in scorers(policy):
        scorer._rough = None
    return policy


def with_whole_maps(policy: TaePolicy) -> TaePolicy:
    """The same policy, which encodes the empty part of end-effector maps, too."""
    for scorer in scorers(policy):
        for part in filter(None, (scorer._exact, scorer._rough)):
            part._encode = part._encode_whole
    return policy


def scorers(policy: TaePolicy) -> tuple[Scorer, ...]:
    """What a policy scores with."""
    return (*policy._by_skill.values(), *policy._by_primitive.values())


def look_errors(network: TaeNetwork, asked: list[ObservationBatch], angles: int) -> dict[str, float]:
    """How far bfloat16 is from float32 at the best valid action of an angle, and how many angles are left."""
    scorer = Scorer(network)
    assert scorer._rough is not None
    every = np.arange(angles)
    errors, left = [], []
    for question in asked:
        scores = scorer.log_odds(question.scene, question.end_effector, angles, question.valid)
        left.append((~np.isneginf(scores[:, 0, 0])).sum(axis=-1))
        for n in range(len(question)):
            valid = np.moveaxis(question.valid[n, ..., :angles], -1, 0)
            best = [
                np.where(valid, part.log_odds(question.scene[n], question.end_effector[n], every), -np.inf).max((1, 2))
                for part in (scorer._exact, scorer._rough)
            ]
            errors.append(np.abs(best[0] - best[1]) / (_MARGIN + _RELATIVE_MARGIN * np.abs(best[0]).max()))
    return {"largest_error_of_margin": float(np.max(errors)), "angles_left": float(np.concatenate(left).mean())}


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
    options.add_argument("--scenarios", type=int, default=1000, help="whose decisions are compared (default 1000)")
    options.add_argument("--repeats", type=int, default=5)
    options.add_argument("--runtimes", action="store_true", help="also try other runtimes")
    arguments = options.parse_args()
    found = [
        measure(arguments.checkpoint, task, arguments.scenarios, arguments.repeats)
        for task in arguments.tasks.split(",")
    ]
    table = Table("task", "way", "decisions/s", "times plain", "equal decisions", title="inference")
    targets, others = [], []
    for row in found:
        table.add_row(row["task"], "plain", f"{median(row['speeds']['plain']):.1f}")
        for name, way in row["ways"].items():
            share = way["equal"] / row["of"]
            speed = median(row["speeds"][name])
            table.add_row("", name, f"{speed:.1f}", f"{way['times']:.1f}", f"{way['equal']:,} of {row['of']:,}")
            what = f"{row['task']}, {name}"
            targets.append(target(f"{what}: plain", ">= 2 times", f"{way['times']:.1f}", way["times"] >= WANTED_RATIO))
            targets.append(target(f"{what}: equal", ">= 99.9%", f"{share:.2%}", share >= WANTED_EQUAL))
            others += [f"{what}: scenario {n} is {ours}, plain {theirs}" for n, theirs, ours in way["others"][:SHOWN]]
    tables, numbers = [table], {"found": found}
    if any(row["look"] for row in found):
        look = Table("task", "angles scored in float32", "largest error / margin", title="the first look in bfloat16")
        for row in found:
            look.add_row(
                row["task"], f"{row['look']['angles_left']:.1f}", f"{row['look']['largest_error_of_margin']:.2f}"
            )
        tables.append(look)
    if arguments.runtimes:
        network, _ = load_checkpoint(next(arguments.checkpoint.glob("*.safetensors")))
        with tempfile.TemporaryDirectory() as name:
            measured = runtimes(network, Path(name), 20)
        other = Table("runtime", "ms", "largest difference of a logit", title="the decoder, 16 angles of a scene")
        for name, (ms, gap) in measured.items():
            other.add_row(name, f"{ms:.1f}", f"{gap:.1g}")
        tables.append(other)
        numbers["runtimes"] = measured
    notes = [f"{torch.get_num_threads()} threads; torch {torch.__version__}.", *others]
    return finish(arguments, "infer", tables, targets, notes, numbers)


if __name__ == "__main__":
    sys.exit(main())
