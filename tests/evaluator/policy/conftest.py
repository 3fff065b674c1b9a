"""Policies as a submitter would write them, from one line of code, and hostile ones."""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

from evaluator.policy import PolicyHost, PolicySpec, resolve

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

LANDLOCK_VERSION = (444, None, 0, 1)
"""The system call that answers which version of Landlock the kernel has; its number is the same on every machine."""


def sandbox_is_possible() -> bool:
    """Whether this kernel has Landlock that covers truncation, and this machine has libseccomp: asked without rema."""
    landlock = ctypes.CDLL(None, use_errno=True).syscall(*LANDLOCK_VERSION) if os.uname().sysname == "Linux" else 0
    return bool(landlock >= 3 and ctypes.util.find_library("seccomp"))


def skip_without_sandbox(host: PolicyHost) -> None:
    """Skip where the machine has no kernel sandbox; where it has one, level L1 fails the test."""
    if host.isolation.level == "L1":
        assert not sandbox_is_possible(), f"this machine has Landlock and libseccomp, but: {host.isolation}"
        pytest.skip(str(host.isolation))


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
