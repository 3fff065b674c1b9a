"""Policies that try what a policy must not do, each in every way that its author could think of.

Every one answers a valid action whose angle says how many of its tries succeeded: 0 is the goal. Run them only
in the sandbox: what they try on the evaluator is harmless, but they do try it.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import mmap
import os
import resource
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np


def answer(count: int, angle: int = 0) -> np.ndarray:
    """The same valid action for every observation, with an angle that carries a number."""
    return np.tile([30, 31, min(angle, 15)], (count, 1))


def successes(tries: Iterable[Callable[[], object]]) -> int:
    """How many of the tries are not denied."""
    done = 0
    for one in tries:
        with contextlib.suppress(OSError, ValueError):
            one()
            done += 1
    return done


class Hostile:
    """Tries everything in ``tries`` whenever it is asked."""

    def __init__(self, checkpoint: Path | None, device: str) -> None:
        self.checkpoint = checkpoint
        self.libc = ctypes.CDLL(None, use_errno=True)

    def act(self, observations: Any) -> np.ndarray:
        return answer(len(observations), successes(self.tries()))

    def tries(self) -> Iterable[Callable[[], object]]:
        raise NotImplementedError

    def call(self, name: str, *arguments: object) -> int:
        """A function of the C library that answers -1 where it failed."""
        found = int(getattr(self.libc, name)(*arguments))
        if found == -1:
            raise OSError(ctypes.get_errno(), name)
        return found


class ReadsScenarios(Hostile):
    """Reads the scenario lists, through every path that leads to them."""

    def tries(self) -> Iterable[Callable[[], object]]:
        from rema_data.manifests import manifests_dir

        folder = manifests_dir()
        files = [path for path in folder.rglob("*") if path.is_file()] or list(folder.glob("scenarios/v1/*.parquet"))
        names = ("manifest.json", "grasp_test.parquet", "grasp_val.parquet", "push_test.parquet")
        files += [folder / "scenarios" / "v1" / name for name in names]
        around = [Path("/proc/self/root", *path.parts[1:]) for path in files]
        history = [folder.parent / ".git" / "HEAD", folder.parent / ".git" / "packed-refs"]
        link = Path(tempfile.gettempdir(), "link")
        yield lambda: os.symlink(folder, link)  # allowed, and of no use: counted below
        for path in (*files, *around, *history, link / "scenarios" / "v1" / "manifest.json"):
            yield lambda path=path: path.read_bytes()[:1]
        yield lambda: os.link(files[0], Path(tempfile.gettempdir(), "hard"))


class InspectsEvaluator(Hostile):
    """Reads the memory, the environment and the open files of the process that started it."""

    def tries(self) -> Iterable[Callable[[], object]]:
        evaluator = Path("/proc", str(os.getppid()))
        for name in ("mem", "environ", "maps", "cmdline", "fd/0", "stack", "auxv"):
            yield lambda name=name: os.close(os.open(evaluator / name, os.O_RDONLY))
        yield lambda: os.listdir(evaluator / "fd")
        yield lambda: self.call("ptrace", 16, os.getppid(), 0, 0)
        buffer = ctypes.create_string_buffer(8)
        vector = (ctypes.c_size_t * 2)(ctypes.addressof(buffer), 8)
        yield lambda: self.call("process_vm_readv", os.getppid(), vector, 1, vector, 1, 0)


class SignalsEvaluator(Hostile):
    """Signals the process that started it, and lowers what that may use."""

    def tries(self) -> Iterable[Callable[[], object]]:
        evaluator = os.getppid()
        for number in (0, signal.SIGCONT):
            yield lambda number=number: os.kill(evaluator, number)
            yield lambda number=number: os.killpg(os.getpgid(evaluator), number)
        yield lambda: resource.prlimit(evaluator, resource.RLIMIT_CORE, (0, 0))
        yield lambda: signal.pidfd_send_signal(os.pidfd_open(evaluator), 0)


class OpensSockets(Hostile):
    """Opens a socket of every kind."""

    def tries(self) -> Iterable[Callable[[], object]]:
        for family in (socket.AF_INET, socket.AF_INET6, socket.AF_UNIX, socket.AF_NETLINK):
            for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM, socket.SOCK_RAW):
                yield lambda family=family, kind=kind: socket.socket(family, kind).close()


class StartsProcesses(Hostile):
    """Starts another process."""

    def tries(self) -> Iterable[Callable[[], object]]:
        def fork() -> None:
            if os.fork() == 0:
                time.sleep(60)
                os._exit(0)

        yield fork
        yield lambda: subprocess.Popen(["sleep", "60"])
        yield lambda: subprocess.Popen(["sleep", "60"], start_new_session=True)
        yield lambda: os.posix_spawn("/bin/sleep", ["sleep", "60"], {})
        yield lambda: self.call("vfork")
        yield lambda: os.execv("/bin/sleep", ["sleep", "60"])


class ChangesFiles(Hostile):
    """Changes its own code and weights, and leaves things behind outside its folder."""

    def tries(self) -> Iterable[Callable[[], object]]:
        weights = [] if self.checkpoint is None else [self.checkpoint]
        for path in (Path(__file__), *weights):
            yield lambda path=path: os.close(os.open(path, os.O_WRONLY))
            yield lambda path=path: os.truncate(path, path.stat().st_size)
            yield lambda path=path: path.chmod(path.stat().st_mode)
            yield lambda path=path: os.rename(path, path)
        for folder in ("/tmp", "/dev/shm", "/var/tmp", str(Path(__file__).parent)):
            yield lambda folder=folder: Path(folder, "rema-hostile").write_text("here")
        yield lambda: self.call("shmget", 0, 4096, 0o1600)
        yield lambda: self.call("mq_open", b"/rema-hostile", os.O_CREAT | os.O_RDWR, 0o600, None)


class LiftsLimits(Hostile):
    """Gives itself more than it may have."""

    def tries(self) -> Iterable[Callable[[], object]]:
        unlimited = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
        for kind in (resource.RLIMIT_DATA, resource.RLIMIT_FSIZE):
            yield lambda kind=kind: resource.setrlimit(kind, unlimited)
            yield lambda kind=kind: resource.prlimit(0, kind, unlimited)
        yield lambda: Path("/proc/self/oom_score_adj").write_text("-1000")
        yield lambda: self.call("unshare", 0x10000000)
        yield lambda: self.call("chroot", b"/")


class FillsDisk(Hostile):
    """Writes small files without end."""

    def act(self, observations: Any) -> np.ndarray:
        for number in range(1 << 20):
            Path(tempfile.gettempdir(), str(number)).write_bytes(b"x" * (4 << 20))
        return answer(len(observations))


class FillsDiskUnseen(Hostile):
    """Writes to files that have no name any more."""

    def act(self, observations: Any) -> np.ndarray:
        self.files = []
        for _ in range(500):
            self.files.append(tempfile.TemporaryFile(buffering=0))  # noqa: SIM115
            self.files[-1].write(b"x" * (4 << 20))
        time.sleep(60)
        return answer(len(observations))


class WritesOneFile(Hostile):
    """Writes one file without end."""

    def act(self, observations: Any) -> np.ndarray:
        with open(Path(tempfile.gettempdir(), "large"), "wb") as file:
            while True:
                file.write(b"x" * (4 << 20))


class Allocates(Hostile):
    """Takes memory without end."""

    def act(self, observations: Any) -> np.ndarray:
        hoard = []
        while True:
            hoard.append(np.ones(8 << 20))


class AllocatesShared(Hostile):
    """Takes memory without end, of the kind that no limit of a process counts."""

    def act(self, observations: Any) -> np.ndarray:
        hoard = []
        while True:
            hoard.append(mmap.mmap(-1, 16 << 20))
            hoard[-1].write(b"x" * (16 << 20))
            time.sleep(0.01)


class Dawdles(Hostile):
    """Takes almost as long as it may, every time."""

    def act(self, observations: Any) -> np.ndarray:
        time.sleep(0.4)
        return answer(len(observations))


class Remembers(Hostile):
    """Keeps what it saw, in memory and on disk, and answers how often it was asked before."""

    asked = 0

    def act(self, observations: Any) -> np.ndarray:
        notes = Path(tempfile.gettempdir(), "notes")
        before = max(Remembers.asked, len(notes.read_text()) if notes.exists() else 0)
        Remembers.asked = before + 1
        notes.write_text("x" * Remembers.asked)
        if (observations.scene < 0).any():
            os._exit(1)
        return answer(len(observations), before)


class CountsQuestions(Hostile):
    """Looks at nothing: its action says which observation of its process this is, as if that were the scenario."""

    def __init__(self, checkpoint: Path | None, device: str) -> None:
        super().__init__(checkpoint, device)
        self.seen = 0

    def act(self, observations: Any) -> np.ndarray:
        numbers = self.seen + np.arange(len(observations))
        self.seen += len(observations)
        return table_of_actions(numbers)


class RemembersObservations(Hostile):
    """Answers by all that its process was shown so far, the observation itself included."""

    def __init__(self, checkpoint: Path | None, device: str) -> None:
        super().__init__(checkpoint, device)
        self.memory = hashlib.sha256()

    def act(self, observations: Any) -> np.ndarray:
        numbers = []
        for scene in observations.scene:
            self.memory.update(np.ascontiguousarray(scene).tobytes())
            numbers.append(int.from_bytes(self.memory.digest()[:4], "big"))
        return table_of_actions(np.array(numbers))


def table_of_actions(numbers: np.ndarray) -> np.ndarray:
    """A valid action for every number, another one for each of 0 to 10,239."""
    return np.stack([20 + numbers // 16 % 20, 16 + numbers // 320 % 32, numbers % 16], axis=1)


class FlipsPrivilege(Hostile):
    """Asks for the ground truth from its second process on, and dies whenever it is asked without."""

    privileged = False

    def __init__(self, checkpoint: Path | None, device: str) -> None:
        super().__init__(checkpoint, device)
        assert checkpoint is not None
        FlipsPrivilege.privileged = checkpoint.read_text() != ""
        checkpoint.write_text("started before")  # in the sandbox it would have to guess, by the clock for instance

    def act(self, observations: Any, situations: Any = ()) -> np.ndarray:
        if not situations:
            os._exit(1)
        return answer(len(observations), 15)


class Erratic(Hostile):
    """Fails in another way on every eighth scene or so, and always in the same way on the same scene."""

    def act(self, observations: Any) -> np.ndarray:
        found = answer(len(observations)).astype(float)
        for n, scene in enumerate(observations.scene):
            number = round(float(scene.sum()) * 1e4)
            if number % 61 == 0:
                os._exit(9)
            if number % 61 == 1:
                raise RuntimeError("no idea")
            if number % 61 == 2:
                subprocess.Popen(["sleep", "60"])
            if number % 61 == 3:
                found[n] = np.nan
        return found if np.isnan(found).any() else found.astype(int)
