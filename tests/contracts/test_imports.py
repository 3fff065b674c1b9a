"""What importing a package costs, and that randomness is never global. Which room may import which: pyproject.toml."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("folder", ["rema_data", "evaluator", "baselines"])
def test_no_global_random_state(folder: str) -> None:
    """Randomness comes from generators that are passed in."""
    allowed = {"Generator", "SeedSequence", "default_rng", "Philox"}
    found = sorted((ROOT / folder).rglob("*.py"))
    assert found
    for path in found:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                assert "random" not in {alias.name for alias in node.names}, path
            if (
                isinstance(node, ast.Attribute)
                and isinstance(node.value, ast.Attribute)
                and node.value.attr == "random"
                and isinstance(node.value.value, ast.Name)
                and node.value.value.id in ("np", "numpy", "torch")
            ):
                assert node.attr in allowed, f"{path}:{node.lineno} uses {node.attr}"


@pytest.mark.parametrize(
    ("module", "absent"),
    [
        ("rema_data", ("pybullet", "torch", "pyarrow")),
        ("evaluator.sim.simulator", ("torch", "scipy", "pandas", "pyarrow")),
        ("evaluator.sim.observation", ("pybullet", "torch")),
        ("evaluator.cli.main", ("numpy", "pybullet", "torch", "pyarrow")),
    ],
)
def test_light_imports(module: str, absent: tuple[str, ...]) -> None:
    code = f"import sys, {module}; print(sorted(set({absent!r}) & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert result.stdout.splitlines()[-1] == "[]"
