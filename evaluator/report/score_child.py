"""A policy's own process, asked for its maps: ``python -m evaluator.report.score_child QUESTIONS.npz ANSWERS.npz``."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np

from evaluator.policy.interface import ObservationBatch
from rema_data import grid


def main(question: str, answer: str) -> None:
    """Load the policy, ask it batch by batch, and write what its maps say about the recorded actions."""
    with np.load(question, allow_pickle=False) as file:
        asked: dict[str, Any] = dict(file)
    path, class_name, device, checkpoint = (str(word) for word in asked["policy"])
    policy = _class(Path(path), class_name)(Path(checkpoint) if checkpoint else None, device)
    if not callable(getattr(policy, "maps", None)):
        raise SystemExit(f"class {class_name} has no method maps(observations)")
    primitive, embodiment, task = (str(word) for word in asked["words"])
    chosen, best = [], []
    for start in range(0, len(asked["scene"]), int(asked["batch"])):
        part = slice(start, start + int(asked["batch"]))
        scene = asked["scene"][part]
        valid = np.broadcast_to(asked["valid"], (len(scene), *asked["valid"].shape))
        batch = ObservationBatch(
            scene, asked["end_effector"][part], primitive, embodiment, task, int(asked["step"]), valid
        )
        scores = np.asarray(policy.maps(batch), np.float32)
        wanted = (len(scene), grid.SCENE_PIXELS, grid.SCENE_PIXELS)
        if scores.ndim != 4 or scores.shape[:3] != wanted or not 1 <= scores.shape[3] <= grid.ANGLES:
            raise SystemExit(f"maps has shape {scores.shape}, expected {(*wanted, grid.ANGLES)} or fewer angles")
        i, j, k = grid.decode(asked["action"][part])
        if (k >= scores.shape[3]).any():
            raise SystemExit("maps has no score for an angle that the policy chose")
        chosen.append(scores[np.arange(len(scene)), i, j, k])
        allowed = np.where(valid[..., : scores.shape[3]], scores, np.float32(-np.inf)).max(axis=3)
        best.append(np.where(np.isfinite(allowed), allowed, np.float32(np.nan)))
    np.savez(Path(answer), chosen=np.concatenate(chosen), best=np.concatenate(best))


def _class(path: Path, class_name: str) -> Any:
    sys.path.insert(0, str(path.parent))
    name = f"submitted_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return getattr(module, class_name)


if __name__ == "__main__":
    main(*sys.argv[1:])
