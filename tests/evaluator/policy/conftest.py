"""Policies as a submitter would write them, from one line of code, and hostile ones."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

from evaluator.policy import PolicySpec, resolve

WritePolicy = Callable[..., PolicySpec]

REPLIES = """
import fcntl
def replies():
    for fd in range(3, 64):
        try:
            if fcntl.fcntl(fd, fcntl.F_GETFL) & os.O_ACCMODE == os.O_WRONLY:
                return fd
        except OSError:
            pass
"""
"""Code that finds the pipe on which the policy's process answers."""


@pytest.fixture
def write_policy(tmp_path: Path) -> WritePolicy:
    """``write_policy(act_body, top="", init="pass")`` writes my_policy.py and resolves it."""

    def write(act: str, top: str = "", init: str = "pass") -> PolicySpec:
        indent = " " * 8
        code = (
            f"import os, sys, time\nimport numpy as np\n{textwrap.dedent(top)}\n"
            "class Policy:\n"
            "    def __init__(self, checkpoint, device):\n"
            f"{textwrap.indent(textwrap.dedent(init).strip(), indent)}\n"
            "    def act(self, observations):\n"
            "        n = len(observations.scene)\n"
            "        good = np.tile([30, 31, 2], (n, 1))\n"
            f"{textwrap.indent(textwrap.dedent(act).strip(), indent)}\n"
        )
        path = tmp_path / "my_policy.py"
        path.write_text(code)
        return resolve(str(path))

    return write
