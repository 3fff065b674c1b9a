"""Inference speed: decisions a second of the learned policy, and how many are those of float32 over all angles.

    python benchmarks/infer.py --checkpoint releases/checkpoints/rema-v1/joint    # some minutes
    python benchmarks/infer.py --checkpoint FOLDER --scenarios 100 --runtimes

The scenarios are the first ones of the validation lists. ``plain`` puts every scene with every angle through the whole
network, as it was trained, 16 pairs at a time. ``ours`` is the policy as it is; ``all angles in float32`` is the same
without the first look in bfloat16, and ``whole maps`` with end-effector maps encoded whole, too; OpenVINO is tried
where it is installed.
All ways are timed, in turns, on a few scenarios, and their decisions there (the best valid action) are compared with
the plain ones. On all scenarios ``ours`` and OpenVINO are compared with float32 over all angles; decisions that differ
are named. The errors of bfloat16 are measured on the timed scenarios, at the best action of each angle.
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
from rich.console import Console
from rich.progress import track
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
TIMED = 2
"""Batches that are timed."""
SHOWN = 5
"""Other decisions that are printed of every way and task; the result file has all."""
WANTED_EQUAL = 0.999
TOOL_TASKS, TOOL_DECISIONS, WITHIN_S = ("grasp_push", "grasp_grasp"), 10_000, 480
PLAIN, OURS, FLOAT32, WHOLE, OPENVINO = "plain", "ours", "all angles in float32", "whole maps", "OpenVINO"


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
    """Decisions a second of every way, in turns, and the scenarios that it decides otherwise than its reference."""
    asked = questions(task, scenarios)
    network, _ = load_checkpoint(checkpoint / f"{asked[0].primitive}.safetensors")
    angles = 8 if asked[0].embodiment in ("sticks", "pinched") else 16
    ways: dict[str, Callable[[ObservationBatch], np.ndarray]] = {
        PLAIN: lambda question: plain(network, question, angles),
        OURS: TaePolicy(checkpoint).act,
        FLOAT32: without_look(TaePolicy(checkpoint)).act,
        WHOLE: with_whole_maps(TaePolicy(checkpoint)).act,
    }
    if find_spec("openvino") is not None:
        ways[OPENVINO] = TaePolicy(checkpoint, "openvino").act
    some = asked[:TIMED]
    decided = {name: [act(question) for question in some] for name, act in ways.items()}  # and to warm up
    speeds: dict[str, list[float]] = {name: [] for name in ways}
    for _ in track(range(repeats), f"{task}: timing", transient=True, console=Console(stderr=True)):
        for name, act in ways.items():
            began = time.perf_counter()
            for question in some:
                act(question)
            speeds[name].append(sum(map(len, some)) / (time.perf_counter() - began))
    rows = {}
    for name in ways:
        if name != PLAIN:
            times = median(a / b for a, b in zip(speeds[name], speeds[PLAIN], strict=True))
            rows[name] = {"times": times, "plain": differences(decided[PLAIN], decided[name])}
    for question in track(asked[TIMED:], f"{task}: comparing", transient=True, console=Console(stderr=True)):
        for name in {OURS, FLOAT32, OPENVINO} & set(ways):
            decided[name].append(ways[name](question))
    for name in {OURS, OPENVINO} & set(ways):
        rows[name]["float32"] = differences(decided[FLOAT32], decided[name])
    looked = look_errors(network, some, angles) if multiplies_bfloat16() else None
    return {"task": task, "speeds": speeds, "ways": rows, "look": looked}


def differences(wanted: list[np.ndarray], found: list[np.ndarray]) -> dict[str, Any]:
    """How many decisions were compared (``of``) and are ``equal``, and the others: scenario, wanted, found."""
    first, second = np.concatenate(wanted), np.concatenate(found)
    wrong = np.flatnonzero(first != second)
    others = [[int(n), int(first[n]), int(second[n])] for n in wrong]
    return {"of": len(first), "equal": len(first) - len(wrong), "others": others}


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


def report(found: list[dict[str, Any]]) -> tuple[list[Table], list[dict[str, Any]], list[str]]:
    """Tables, targets, and the decisions that differ in words."""
    table = Table(
        "task", "way", "decisions/s", "times plain", "equal to plain", "equal to all angles in float32",
        title="inference",
    )  # fmt: skip
    targets, others = [], []
    for row in found:
        table.add_row(row["task"], PLAIN, f"{median(row['speeds'][PLAIN]):.1f}", "", "", "")
        for name, way in row["ways"].items():
            counts = {
                what: f"{way[what]['equal']:,} of {way[what]['of']:,}" for what in ("plain", "float32") if what in way
            }
            speed = f"{median(row['speeds'][name]):.1f}"
            table.add_row("", name, speed, f"{way['times']:.1f}", counts["plain"], counts.get("float32", ""))
            for what in counts:
                others += [
                    f"{row['task']}, {name}: scenario {n} is {ours}, {what} {theirs}"
                    for n, theirs, ours in way[what]["others"][:SHOWN]
                ]
        if row["task"] in TOOL_TASKS:
            speed = median(row["speeds"][OURS])
            targets.append(
                target(
                    f"{row['task']}: {TOOL_DECISIONS:,} decisions",
                    f"<= {WITHIN_S / 60:.0f} min",
                    f"{TOOL_DECISIONS / speed / 60:.1f} min",
                    TOOL_DECISIONS / speed <= WITHIN_S,
                )
            )
    for name in (OURS, OPENVINO):
        compared = [row["ways"][name]["float32"] for row in found if name in row["ways"]]
        if compared:
            share = sum(one["equal"] for one in compared) / sum(one["of"] for one in compared)
            what = f"{name}: equal to all angles in float32"
            targets.append(target(what, f">= {WANTED_EQUAL:.1%}", f"{share:.2%}", share >= WANTED_EQUAL))
    tables = [table]
    if any(row["look"] for row in found):
        look = Table("task", "angles scored in float32", "largest error / margin", title="the first look in bfloat16")
        for row in found:
            look.add_row(
                row["task"], f"{row['look']['angles_left']:.1f}", f"{row['look']['largest_error_of_margin']:.2f}"
            )
        tables.append(look)
    return tables, targets, others


def main() -> int:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--checkpoint", type=Path, required=True, help="folder with grasp and push")
    options.add_argument("--tasks", default="grasp,push,grasp_push,grasp_grasp")
    options.add_argument("--scenarios", type=int, default=256, help="of each task whose decisions are compared")
    options.add_argument("--repeats", type=int, default=3)
    options.add_argument("--runtimes", action="store_true", help="also try other runtimes")
    arguments = options.parse_args()
    found = [
        measure(arguments.checkpoint, task, arguments.scenarios, arguments.repeats)
        for task in arguments.tasks.split(",")
    ]
    tables, targets, others = report(found)
    numbers: dict[str, Any] = {"found": found}
    if arguments.runtimes:
        network, _ = load_checkpoint(next(arguments.checkpoint.glob("*.safetensors")))
        with tempfile.TemporaryDirectory() as name:
            measured = runtimes(network, Path(name), 20)
        other = Table("runtime", "ms", "largest difference of a logit", title="the decoder, 16 angles of a scene")
        for name, (ms, gap) in measured.items():
            other.add_row(name, f"{ms:.1f}", f"{gap:.1g}")
        tables.append(other)
        numbers["runtimes"] = measured
    notes = [f"Threads: {torch.get_num_threads()}; torch {torch.__version__}.", *others]
    return finish(arguments, "infer", tables, targets, notes, numbers)


if __name__ == "__main__":
    sys.exit(main())
