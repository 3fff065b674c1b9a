"""Notes in every wheel the commit that it was built from: runs of an installed package record it."""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

NOTE = "evaluator/_commit.json"


class CommitHook(BuildHookInterface):
    """Adds ``evaluator/_commit.json`` to wheels that are built in a checkout."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called before a wheel is built; ``version`` is ``editable`` where the checkout itself will be run."""
        self._folder: str | None = None
        root = Path(self.root)
        if version == "editable" or not (root / ".git").exists():
            return
        try:
            commit = _git(root, "rev-parse", "HEAD")
            dirty = bool(_git(root, "status", "--porcelain", "--untracked-files=no"))
        except (OSError, subprocess.SubprocessError):
            return
        self._folder = tempfile.mkdtemp()
        note = Path(self._folder) / "commit.json"
        note.write_text(json.dumps({"commit": commit, "dirty": dirty}) + "\n", encoding="utf-8")
        build_data["force_include"][str(note)] = NOTE

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Called after it was built."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)


def _git(root: Path, *arguments: str) -> str:
    command = ["git", "--no-optional-locks", *arguments]
    return subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=10, check=True).stdout.strip()
