"""What a policy's process is started with: its command, its environment, and what it may reach."""

from __future__ import annotations

import grp
import os
import pwd
import secrets
import site
import stat
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import psutil

from evaluator.policy.sandbox.allowlist import allowed_for, packages_folder, python_folders
from evaluator.policy.sandbox.limits import PolicyLimits
from evaluator.policy.sandbox.snapshot import Snapshot
from evaluator.policy.sandbox.wrapper import check_sandbox, wrapped
from rema_data.manifests import manifests_dir

__all__ = ["LaunchSpec", "runs_beside", "unused_user"]

_UNUSED_USERS = range(61184, 65520)
"""Numbers that systems keep for users without an account (systemd: DynamicUser)."""

_KEPT_VARIABLES = (
    "PATH", "USER", "LANG", "LC_ALL", "LC_CTYPE", "TZ", "VIRTUAL_ENV", "CONDA_PREFIX", "PYTHONPATH", "LD_LIBRARY_PATH",
    "CUDA_HOME", "CUDA_VISIBLE_DEVICES", "HIP_VISIBLE_DEVICES", "OMP_NUM_THREADS", "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS", "OPENBLAS_CORETYPE", "SYSTEMROOT",
)  # fmt: skip
"""All that a policy inherits: enough to find its libraries and its device, nothing about the run."""
_RUN_FILE = "run.json"
_KERNEL = "evaluator.policy.sandbox.kernel"


@dataclass(frozen=True, slots=True)
class LaunchSpec:
    """How the process of a policy is started. InputError where the wrapper's command cannot be used."""

    snapshot: Snapshot  # the policy's files
    limits: PolicyLimits = field(default_factory=PolicyLimits)
    hidden: tuple[Path, ...] = ()  # what else the policy must not read
    confine: bool = True  # whether the kernel restricts the process (Landlock, seccomp)
    user: int | None = None  # that the process becomes, where the evaluator is root
    sandbox: str | None = None  # a wrapper's command, see ``evaluator.policy.sandbox.wrapper``

    def __post_init__(self) -> None:
        check_sandbox(self.sandbox)

    def command(self, temporary: Path) -> list[str]:
        """The words that start the process, whose working folder is ``temporary``."""
        # -P: a folder of modules named like those of the standard library must not come before them.
        python = [sys.executable, "-P", "-m", _KERNEL]
        if self.sandbox is None:
            return python
        places = {
            "tmp": temporary,
            "policy": self.snapshot.policy.parent,
            "checkpoint": self.snapshot.checkpoint or self.snapshot.policy.parent,
            "packages": packages_folder(),
            "python": Path(sys.prefix),
            "python_base": Path(sys.base_prefix),
            "manifests": manifests_dir().resolve(),
        }
        return wrapped(check_sandbox(self.sandbox), places, python)

    def environment(self, temporary: Path) -> dict[str, str]:
        """A small environment: the same for every run, with the folder of this package importable."""
        kept = {name: os.environ[name] for name in _KEPT_VARIABLES if name in os.environ}
        inherited = [entry for entry in kept.pop("PYTHONPATH", "").split(os.pathsep) if entry]
        # A wheel's folder is on the path of the child anyway; naming it would put it before the standard library.
        root = packages_folder()
        own = [] if root.name in ("site-packages", "dist-packages") else [str(root)]
        paths = [str(self.snapshot.moved(Path(os.path.abspath(entry)))) for entry in (*own, *inherited)]
        return {
            **kept,
            **({"PYTHONPATH": os.pathsep.join(paths)} if paths else {}),
            **({"PYTHONUSERBASE": site.getuserbase()} if site.ENABLE_USER_SITE else {}),
            "PYTHONHASHSEED": "0",  # the order of sets must not differ between two runs
            "PYTHONDONTWRITEBYTECODE": "1",
            "PYTHONUNBUFFERED": "1",
            "HDF5_USE_FILE_LOCKING": "FALSE",  # the sandbox has no locks
            "TORCH_FORCE_WEIGHTS_ONLY_LOAD": "1",  # a pickle is a program
            "HOME": str(temporary),
            "TMPDIR": str(temporary),
        }

    def orders(self, temporary: Path) -> dict[str, Any]:
        """The first message to ``evaluator.policy.sandbox.kernel``."""
        limits = {
            "RLIMIT_CORE": 0,
            "RLIMIT_DATA": self.limits.memory,
            "RLIMIT_FSIZE": self.limits.disk_bytes,
            "RLIMIT_NOFILE": self.limits.open_files,
        }
        # The kernel counts the tasks of every user but root, which becomes a user that has none.
        limits["RLIMIT_NPROC"] = self.limits.tasks + (0 if self.user is not None else _tasks_of_user())
        hidden, environment = (*self.hidden, *self.snapshot.hidden), self.environment(temporary)
        allowed = asdict(allowed_for(self.snapshot.read, temporary, environment, hidden))
        return {
            "op": "confine",
            "confine": self.confine,
            "limits": limits,
            "allowed": allowed,
            "user": self.user,
            "imports": [str(path) for path in python_folders(environment)],
            "groups": sorted(_groups_of(allowed["devices"])),
            "temporary": {
                "path": str(temporary),
                "bytes": self.limits.disk_bytes,
                "files": self.limits.disk_files,
            },
        }


def runs_beside(run: Path | None) -> tuple[Path, ...]:
    """The folder of a run, and those beside it."""
    if run is None:
        return ()
    run = run.resolve()
    beside = run.parent.iterdir() if run.parent.is_dir() else ()
    return (run, *(folder for folder in beside if (folder / _RUN_FILE).is_file()))


def unused_user() -> int | None:
    """The number of a user and a group that no account has, where this process is root; else None."""
    if os.geteuid() != 0:
        return None
    taken = {entry.pw_uid for entry in pwd.getpwall()} | {entry.gr_gid for entry in grp.getgrall()}
    return secrets.choice([number for number in _UNUSED_USERS if number not in taken])


def _groups_of(devices: Iterable[str]) -> set[int]:
    """Groups that may use accelerators which not everybody may use."""
    found = set()
    for device in devices:
        places = [Path(device), *(Path(device).iterdir() if os.path.isdir(device) else ())]
        for about in (place.stat() for place in places):
            if about.st_gid != 0 and not about.st_mode & stat.S_IROTH:
                found.add(about.st_gid)
    return found


def _tasks_of_user() -> int:
    own, count = os.getuid(), 0
    for process in psutil.process_iter(["uids", "num_threads"]):
        uids = process.info["uids"]
        count += (process.info["num_threads"] or 1) if uids is not None and uids.real == own else 0
    return count
