"""The folder of a snapshot: made for one host, removed with it, also when the evaluator is killed."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from evaluator.policy.loading import PolicySpec
from evaluator.policy.sandbox.cleanup import CleanupShell, remove_folder
from evaluator.policy.sandbox.launch_spec import runs_beside, unused_user
from evaluator.policy.sandbox.snapshot import take_snapshot

__all__ = ["PrivateCopy", "held"]


class PrivateCopy:
    """A snapshot of a policy in a temporary folder that nobody else reads.

    Without what is ``hidden``. ``user`` is who will read it, where that is not the present one: a process of root
    becomes another. Raises what ``take_snapshot`` raises.
    """

    def __init__(self, spec: PolicySpec, checkpoint: Path | None, hidden: Iterable[Path]) -> None:
        self.user = unused_user()
        # Resolved: it is compared with the folders that the policy may reach.
        self._folder = Path(tempfile.mkdtemp(prefix="rema-copy-")).resolve()
        try:
            self._cleanup = CleanupShell(self._folder)
        except BaseException:
            remove_folder(self._folder)
            raise
        try:
            self.snapshot = take_snapshot(spec, checkpoint, self._folder, hidden)
            if self.user is not None:
                os.chown(self._folder, -1, self.user)  # a group of this number
                self._folder.chmod(0o750)
        except BaseException:
            self.remove()
            raise

    def remove(self) -> None:
        """Remove the folder."""
        remove_folder(self._folder)
        self._cleanup.dismiss()


@contextmanager
def held(spec: PolicySpec, checkpoint: Path | None, run: Path) -> Iterator[PolicySpec]:
    """The policy as it is now, for all processes of a ``run``: what changes in its folder meanwhile has no effect."""
    copy = PrivateCopy(spec, checkpoint, runs_beside(run))
    try:
        yield replace(spec, copy=copy)
    finally:
        copy.remove()
