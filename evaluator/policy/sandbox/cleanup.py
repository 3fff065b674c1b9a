"""End the processes of a policy and remove its folder, also when the evaluator itself is killed."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import psutil

__all__ = ["CleanupShell", "descendants", "end_family", "remove_folder"]

# `read` succeeds when the evaluator has cleaned up, and fails when it ended before that. By then the kernel has ended
# the policy; the processes that it started live on in its group.
_SCRIPT = 'read -r goodbye && exit; [ -n "$1" ] && kill -s KILL -- "-$1"; chmod -R u+rwx -- "$2"; rm -rf -- "$2"'


class CleanupShell:
    """A shell that outlives the evaluator for a moment, to remove a folder and to end a process group."""

    def __init__(self, folder: Path, group: int | None = None) -> None:
        reader, self._lifeline = os.pipe()  # only the evaluator holds the write end: it is not inherited
        try:
            self._shell = subprocess.Popen(
                ["/bin/sh", "-c", _SCRIPT, "rema-policy-cleanup", str(group or ""), str(folder)],
                stdin=reader,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        except BaseException:
            os.close(self._lifeline)
            raise
        finally:
            os.close(reader)

    def dismiss(self) -> None:
        """End the shell: the evaluator has cleaned up."""
        with suppress(OSError):
            os.write(self._lifeline, b"\n")
        os.close(self._lifeline)
        self._shell.wait()


def descendants(process: subprocess.Popen[bytes]) -> list[psutil.Process]:
    """Children of ``process``, and their children; complete while ``process`` lives."""
    with suppress(psutil.Error):
        found: list[psutil.Process] = psutil.Process(process.pid).children(recursive=True)
        return found
    return []


def end_family(process: subprocess.Popen[bytes], folder: Path, known: Iterable[psutil.Process] = ()) -> None:
    """End ``process``, its group, its ``known`` and other descendants, and remove its working ``folder``.

    A process that left the group is found by its ancestors, or by the temporary folder that it inherited. Where the
    sandbox does not deny new processes, one can escape: it empties its environment, and its parent and the policy end
    first.
    """
    members = [*known, *_strayed(folder), *descendants(process)]
    # The leader was not waited for yet, so the number of the group is still its own.
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    for member in members:
        with suppress(psutil.Error):
            member.kill()
    process.wait()
    remove_folder(folder)


def remove_folder(folder: Path) -> None:
    """Remove the folder of a policy, which may hold folders that deny access or are nested very deeply."""
    with suppress(RecursionError):
        shutil.rmtree(folder, ignore_errors=True)
    if folder.exists():
        for command in (["chmod", "-R", "u+rwx"], ["rm", "-rf"]):
            with suppress(OSError):
                subprocess.run([*command, "--", str(folder)], check=False, stderr=subprocess.DEVNULL)


def _strayed(folder: Path) -> list[psutil.Process]:
    """Processes of this user whose temporary folder is ``folder``."""
    found = []
    for candidate in psutil.process_iter():
        with suppress(psutil.Error, OSError):
            if candidate.environ().get("TMPDIR") == str(folder):
                found.append(candidate)
    return found
