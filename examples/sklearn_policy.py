"""A learned policy in scikit-learn: trees judge every action near the object, and the best one is taken.

    pip install scikit-learn
    python examples/sklearn_policy.py --output trees.joblib              # fits the trees: some seconds
    rema evaluate examples/sklearn_policy.py --checkpoint trees.joblib --task grasp --episodes 200

It sees the scene alone, not what the hand holds: it is for the bare hand, so for the tasks grasp and push.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray
from patches import candidates, features, mirrored
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.metrics import roc_auc_score

import rema_data
from evaluator.policy import ObservationBatch
from rema_data import grid
from rema_data.errors import RemaError

Array = NDArray[Any]


class Policy:
    def __init__(self, checkpoint: Path | None, device: str) -> None:
        if checkpoint is None:
            raise ValueError("no trees: python examples/sklearn_policy.py makes them, and --checkpoint names them")
        self.trees = joblib.load(checkpoint)  # a pickle runs code as it is read: here, in the sandbox of the policy

    def act(self, observations: ObservationBatch) -> Array:
        """The action (i, j, k) that most likely succeeds, for every observation."""
        trees = self.trees[observations.primitive]
        actions = []
        for scene, valid in zip(observations.scene, observations.valid, strict=True):
            i, j, k = candidates(scene, valid, observations.primitive)
            best = trees.predict_proba(features(scene, i, j, k, observations.primitive))[:, 1].argmax()
            actions.append((i[best], j[best], k[best]))
        return np.array(actions)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--release", default="rema-mini", help="name or folder")
    parser.add_argument("--trees", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path, default=Path("trees.joblib"))
    options = parser.parse_args()
    try:
        release = rema_data.load(options.release)
        trees = {primitive: fit(release, primitive, options) for primitive in ("grasp", "push")}
    except RemaError as error:  # with the edit or the command that fixes it
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
    joblib.dump(trees, options.output, compress=3)
    print(options.output)


def fit(release: rema_data.Release, primitive: str, options: argparse.Namespace) -> Any:
    """Trees that tell the successes of a primitive from its failures."""
    scene, i, j, k, success = steps(release, primitive, "train")
    once = np.vstack([features(scene, i, j, turned, primitive) for turned in (k, k + 8)])  # the hand turned round
    trees = ExtraTreesClassifier(
        options.trees, min_samples_leaf=2, class_weight="balanced", random_state=options.seed, n_jobs=1
    )
    trees.fit(np.vstack([once, mirrored(once)]), np.tile(success, 4))

    scene, i, j, k, success = steps(release, primitive, "val")
    auc = roc_auc_score(success, trees.predict_proba(features(scene, i, j, k, primitive))[:, 1])
    wins = success.sum()
    print(f"{primitive}, validation: AUC {auc:.3f} over {wins} successes and {len(success) - wins} failures")
    return trees


def steps(release: rema_data.Release, task: str, split: str) -> tuple[Array, Array, Array, Array, Array]:
    """Scenes (N, 64, 64) in metres, rows, columns and angles of the actions, and whether they succeeded."""
    dataset = release.steps(tasks=[task], split=split)
    batch = dataset[range(len(dataset))].float()
    return batch.scene[:, 0].numpy(), *grid.decode(batch.action.numpy()), batch.success.numpy()


if __name__ == "__main__":
    main()
