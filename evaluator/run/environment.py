"""Where and with what a segment of a run was made."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
import sys
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from evaluator.sim.bullet import bullet_version
from rema_data.commands import run_command

__all__ = ["code_commit", "environment", "processor_name", "source_digest"]

_PACKAGES = ("rema", "numpy", "torch", "openvino", "pyarrow", "scipy")
_OWN = ("rema_data", "evaluator", "baselines")
_NOTE = "_commit.json"
"""Written by hatch_build.py."""


def environment() -> dict[str, Any]:
    """Where and with what this process runs: for people, and to see mixed hardware; no part of a run's identity."""
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {
            "host": hashlib.sha256(platform.node().encode()).hexdigest()[:8],
            "system": platform.system(),
            "architecture": platform.machine(),
            "processor": processor_name(),
            "cores": os.cpu_count(),
        },
        "versions": {"python": platform.python_version(), **_versions()},
        "packages": {name: source_digest(name) for name in _OWN if find_spec(name) is not None},
        **code_commit(),
    }


def _versions() -> dict[str, str]:
    found = {} if (bullet := bullet_version()) is None else {"pybullet": bullet}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def processor_name() -> str:
    """The processor as the system names it."""
    if sys.platform == "linux":
        with suppress(OSError), open("/proc/cpuinfo", encoding="utf-8") as file:
            for line in file:
                if line.startswith("model name"):
                    return line.partition(":")[2].strip()
    return platform.processor()


def code_commit() -> dict[str, Any]:
    """Commit of the checkout or wheel that this code runs from, and whether that was changed; null where unknown."""
    root = Path(__file__).resolve().parents[2]
    if (root / ".git").exists():
        try:
            head = _git(root, "rev-parse", "HEAD")
            return {"commit": head, "dirty": bool(_git(root, "status", "--porcelain", "--untracked-files=no"))}
        except (OSError, subprocess.SubprocessError):
            pass
    with suppress(OSError, ValueError, KeyError):
        noted = json.loads((root / "evaluator" / _NOTE).read_text(encoding="utf-8"))
        return {"commit": noted["commit"], "dirty": noted["dirty"]}
    return {"commit": None, "dirty": None}


def _git(root: Path, *arguments: str) -> str:
    # Without optional locks: looking must not write into the checkout.
    done = run_command(["git", "--no-optional-locks", *arguments], root, timeout=10)
    done.check_returncode()
    return done.stdout.decode().strip()


def source_digest(*names: str) -> str:
    """Sha256 (hex) over names and contents of the Python files of packages and modules; imports only their packages."""
    total = hashlib.sha256()
    for found in filter(None, map(find_spec, names)):
        folders = [Path(folder) for folder in sorted(found.submodule_search_locations or ())]
        files = [(path, folder) for folder in folders for path in sorted(folder.rglob("*.py"))]
        for path, folder in files or [(Path(str(found.origin)), Path(str(found.origin)).parent)]:
            total.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return total.hexdigest()
