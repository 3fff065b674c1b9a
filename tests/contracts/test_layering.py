"""The arrows between the packages: rema_data <- evaluator <- baselines, and the world is a leaf."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def imported(path: Path, root: Path = ROOT) -> set[str]:
    """Every module that a file imports, anywhere in it, relative imports resolved."""
    package = path.relative_to(root).with_suffix("").parts
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: -node.level]) if node.level else ""
            module = ".".join(part for part in (base, node.module) if part)
            names |= {module} | {f"{module}.{alias.name}" for alias in node.names}
    return names


def modules(folder: str) -> list[Path]:
    found = sorted((ROOT / folder).rglob("*.py"))
    assert found
    return found


def breaches(folder: str, forbidden: tuple[str, ...]) -> list[str]:
    return [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in modules(folder)
        for name in imported(path)
        if name.split(".")[0] in forbidden
    ]


def test_data_knows_no_judge_and_no_contestant() -> None:
    assert breaches("rema_data", ("evaluator", "baselines", "pybullet", "pybullet_data")) == []


def test_judge_knows_no_contestant() -> None:
    assert breaches("evaluator", ("baselines",)) == []


def test_world_is_a_leaf() -> None:
    allowed = ("rema_data.schema", "rema_data.grid", "rema_data.errors", "rema_data", "evaluator.sim")
    for path in modules("evaluator/sim"):
        for name in imported(path):
            if name.split(".")[0] in ("rema_data", "evaluator"):
                assert name.startswith(allowed[-1]) or name.startswith(allowed[:3]) or name == "rema_data", (path, name)
        heavy = {"torch", "scipy", "pandas", "pyarrow"} & {name.split(".")[0] for name in imported(path)}
        assert not heavy, (path, heavy)


def test_the_checker_sees_a_breach(tmp_path: Path) -> None:
    """Imports inside functions and relative imports count."""
    (tmp_path / "evaluator").mkdir()
    (tmp_path / "evaluator" / "judge.py").write_text(
        "from . import records\ndef f():\n    from baselines import random_policy\n"
    )
    found = imported(tmp_path / "evaluator" / "judge.py", tmp_path)
    assert {"evaluator.records", "baselines.random_policy"} <= found


@pytest.mark.parametrize("folder", ["rema_data", "evaluator", "baselines"])
def test_no_global_random_state(folder: str) -> None:
    """Randomness comes from generators that are passed in."""
    allowed = {"Generator", "SeedSequence", "default_rng", "Philox"}
    for path in modules(folder):
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
