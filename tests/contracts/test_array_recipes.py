"""The recipes of docs/dataset.md for NumPy, JAX and Grain: a stopped epoch goes on with equal bits, without torch."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SECTION = (ROOT / "docs" / "dataset.md").read_text(encoding="utf-8").split("### NumPy, JAX and Grain\n")[1]
NO_TORCH = "\nimport sys\nassert 'torch' not in sys.modules\n"

NUMPY = "assert scene_m.shape == (8, 1, 64, 64) and step.scene.shape == (64, 64)"
JAX = """
import json, numpy as np
whole = train(jnp.zeros(64 * 64), new_sampler(), updates=20)
assert np.asarray(resumed["weights"]).any()
assert np.asarray(resumed["weights"]).tobytes() == np.asarray(whole["weights"]).tobytes()
assert resumed["sampler"] == whole["sampler"] == json.loads(json.dumps(whole["sampler"]))
"""
GRAIN = """
import json
for batches in (shuffled, balanced):
    first = iter(batches)
    head = [next(first) for _ in range(30)]  # more than an epoch
    state = json.loads(json.dumps(first.get_state()))
    resumed = iter(batches)
    resumed.set_state(state)
    for _ in range(30):
        one, other = next(first), next(resumed)
        assert type(one).__name__.endswith("Arrays") and all(a.tobytes() == b.tobytes() for a, b in zip(one, other))
    assert len({batch.index.tobytes() for batch in head}) == 30
sampler = rema_data.BalancedSampler(dataset, batch_size=8, by=("success",), seed=0)
for one, other in zip(iter(balanced), dataset.numpy_batches(sampler)):
    assert one.scene.tobytes() == other.float().scene.tobytes()
"""


@pytest.mark.parametrize(("module", "check"), [("numpy", NUMPY), ("jax", JAX), ("grain", GRAIN)])
def test_the_recipe(tmp_path: Path, module: str, check: str) -> None:
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"{module} is not installed")
    mark = "" if module == "numpy" else f"<!-- recipe: {module} -->\n\n"
    code = re.search(rf"{mark}```python\n(.*?)```", SECTION, flags=re.DOTALL)
    assert code
    (tmp_path / "recipe.py").write_text(code[1] + check + NO_TORCH)
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "REMA_HOME": str(tmp_path / "home"), "PYTHONPATH": path, "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(
        [sys.executable, "recipe.py"], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=180
    )
    assert done.returncode == 0, done.stderr
