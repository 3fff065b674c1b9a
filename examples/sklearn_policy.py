"""A learned policy in scikit-learn: trees judge the patch of the height map under the hand, for every valid action.

    pip install scikit-learn
    python examples/sklearn_policy.py --output trees.joblib
    rema evaluate examples/sklearn_policy.py --checkpoint trees.joblib --task grasp --episodes 200

The patch is all it sees, not what is held: it is for the bare hand, tasks grasp and push.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from scipy.ndimage import distance_transform_edt
from numpy.typing import NDArray
from sklearn.ensemble import ExtraTreesClassifier, HistGradientBoostingClassifier
from sklearn.neural_network import MLPClassifier
from sklearn.svm import SVC
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

import rema_data
from evaluator.policy import ObservationBatch
from rema_data import grid
from rema_data.errors import RemaError

Array = NDArray[Any]
YAWS = 8  # of the 16 angles: turned by half a turn, the bare hand is the same hand
REACH = {"grasp": 2, "push": 12}  # pixels from the object; trees need not be asked further away
SIDE = np.arange(-6, 7) * 2  # a patch has 13 x 13 points, 9 mm apart


def features(scene: Array, primitive: str, i: Array, j: Array, k: Array) -> Array:
    """Heights (m) at the points of a patch, and the yaw, for every action; float32 (N, 170).

    The patch turns with the hand for a grasp. A push goes to +x whatever the yaw, and so does its patch.
    `scene` (64, 64) is one for all actions, or (N, 64, 64) has one for each.
    """
    yaw = k * 2 * np.pi / 16 if primitive == "grasp" else np.zeros(len(k))
    cos, sin = np.cos(yaw)[:, None, None], np.sin(yaw)[:, None, None]
    along, aside = SIDE[None, None, :] , SIDE[None, :, None]
    if primitive == 'push': along = along + 10
    columns = np.rint(j[:, None, None] + cos * along - sin * aside).astype(int)
    rows = np.rint(i[:, None, None] + sin * along + cos * aside).astype(int)
    inside = (rows >= 0) & (rows < 64) & (columns >= 0) & (columns < 64)
    number = np.arange(len(k))[:, None, None] if scene.ndim == 3 else 0
    scenes = scene if scene.ndim == 3 else scene[None]
    heights = np.where(inside, scenes[number, rows.clip(0, 63), columns.clip(0, 63)], 0)
    return np.column_stack([heights.reshape(len(k), -1), k % YAWS]).astype(np.float32)


class Policy:
    def __init__(self, checkpoint: Path | None, device: str) -> None:
        if checkpoint is None:
            raise ValueError("give the trees: --checkpoint trees.joblib, made by examples/sklearn_policy.py")
        self.models = joblib.load(checkpoint)  # a pickle: it runs code, and the sandbox holds that too

    def act(self, observations: ObservationBatch) -> Array:
        """The valid action that most likely succeeds, for every observation."""
        model = self.models[observations.primitive]
        actions = []
        for scene, valid in zip(observations.scene, observations.valid, strict=True):
            near = distance_transform_edt(scene <= 0.005) <= REACH[observations.primitive]
            i, j, k = np.nonzero(valid[:, :, :YAWS] & near[:, :, None])
            best = model.predict_proba(features(scene, observations.primitive, i, j, k))[:, 1].argmax()
            actions.append((i[best], j[best], k[best]))
        return np.array(actions)


def fit(release, primitive, kind):
    def data(split):
        dataset = release.steps(tasks=[primitive], split=split)
        batch = dataset[range(len(dataset))].float()
        scene, y, a = batch.scene[:, 0].numpy(), batch.success.numpy(), batch.action.numpy()
        i, j, k = grid.decode(a)
        return scene, i, j, k, y
    scene, i, j, k, y = data("train")
    x = features(scene, primitive, i, j, k)
    patches, yaws = x[:, :-1].reshape(-1, 13, 13), x[:, -1]
    if primitive == "grasp":
        xs = [np.column_stack([p.reshape(len(p), -1), yaws]) for p in (patches, patches[:, ::-1], patches[:, :, ::-1], patches[:, ::-1, ::-1])]
    else:
        xs = [x, np.column_stack([patches[:, ::-1].reshape(len(x), -1), -yaws % 8])]
    X, Y = np.concatenate(xs), np.tile(y, len(xs))
    model = {"hgb": lambda: HistGradientBoostingClassifier(max_iter=300, class_weight="balanced", random_state=0),
      "et": lambda: ExtraTreesClassifier(200, min_samples_leaf=2, class_weight="balanced", random_state=0),
      "mlp": lambda: make_pipeline(StandardScaler(), MLPClassifier((128,64), alpha=1e-3, early_stopping=False, max_iter=60, random_state=0)),
    }[kind]()
    model.fit(X, Y)
    scene, i, j, k, y = data("val")
    s = model.predict_proba(features(scene, primitive, i, j, k))[:, 1]
    from sklearn.metrics import roc_auc_score
    print(primitive, kind, "AUC", roc_auc_score(y, s), flush=True)
    return model

def main():
    release = rema_data.load("rema-mini")
    import time
    for kind in ("hgb", "et", "mlp"):
        t=time.process_time()
        joblib.dump({p: fit(release, p, kind) for p in ("grasp", "push")}, f"/tmp/x/{kind}.joblib")
        print(kind, time.process_time()-t)

if __name__ == "__main__":
    main()
