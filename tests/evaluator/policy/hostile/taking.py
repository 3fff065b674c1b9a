"""Policies that take more than they may: disk, memory, threads, files, time."""

from __future__ import annotations

import faulthandler
import fcntl
import mmap
import os
import resource
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from tests.evaluator.policy.hostile.base import Hostile, Tries, answer

_PIECE = b"x" * (4 << 20)
_PIECES = 42  # 168 MB
_F_SETPIPE_SZ = 1031


class Takes(Hostile):
    """Ends as a counted fault."""

    ends = "fault"

    def act(self, observations: Any) -> np.ndarray:
        self.take()
        time.sleep(30)
        return answer(len(observations))

    def take(self) -> None:
        raise NotImplementedError

    def tries(self) -> Tries:
        return ()


class FillsDisk(Takes):
    """Writes files without end."""

    def take(self) -> None:
        for number in range(1 << 20):
            Path(tempfile.gettempdir(), str(number)).write_bytes(_PIECE)


class FillsDiskUnlinked(Takes):
    """Writes to files that have no name any more."""

    def take(self) -> None:
        self.files = []
        for _ in range(_PIECES):
            self.files.append(tempfile.TemporaryFile(buffering=0))  # noqa: SIM115
            if self.files[-1].write(_PIECE) != len(_PIECE):
                raise OSError("full")


class FillsDiskMapped(Takes):
    """Writes to files that are neither open nor named, but mapped."""

    def take(self) -> None:
        self.views = []
        for _ in range(_PIECES):
            with tempfile.TemporaryFile(buffering=0) as file:
                os.posix_fallocate(file.fileno(), 0, len(_PIECE))
                self.views.append(mmap.mmap(file.fileno(), len(_PIECE)))
            self.views[-1].write(_PIECE)


class FillsDiskDeep(Takes):
    """Writes in folders that are nested more deeply than a path can say."""

    def take(self) -> None:
        for _ in range(90):
            os.mkdir("d" * 200)
            os.chdir("d" * 200)
            Path("x").write_bytes(_PIECE)


class FillsDiskUnreadable(Takes):
    """Writes in a folder that nobody may read."""

    def take(self) -> None:
        inside = None
        os.mkdir("hidden")
        inside = os.open("hidden", os.O_RDONLY)
        os.mkdir("deeper", 0o300, dir_fd=inside)
        for number in range(_PIECES):
            Path("hidden", "deeper", str(number)).write_bytes(_PIECE)


class WritesOneFile(Takes):
    """Writes one file without end."""

    def take(self) -> None:
        with open(Path(tempfile.gettempdir(), "large"), "wb") as file:
            while True:
                file.write(_PIECE)


class MakesManyFiles(Takes):
    """Makes files that hold nothing."""

    def take(self) -> None:
        for number in range(200):
            os.mkdir(str(number))


class Allocates(Takes):
    """Takes memory without end."""

    def take(self) -> None:
        hoard = []
        while True:
            hoard.append(np.ones(8 << 20))


class AllocatesShared(Takes):
    """Takes memory without end, of the kind that no limit of a process counts."""

    def take(self) -> None:
        hoard = []
        while True:
            hoard.append(mmap.mmap(-1, 16 << 20))
            hoard[-1].write(b"x" * (16 << 20))


class AllocatesFiles(Takes):
    """Takes memory in files that exist in memory alone."""

    def take(self) -> None:
        for number in range(200):
            os.write(os.memfd_create(str(number)), _PIECE)


class AllocatesPipes(Takes):
    """Takes memory in pipes."""

    def take(self) -> None:
        for _ in range(300):
            _, end = os.pipe()
            fcntl.fcntl(end, _F_SETPIPE_SZ, 1 << 20)
            os.set_blocking(end, False)
            os.write(end, b"x" * (1 << 20))


class OpensManyFiles(Takes):
    """Opens files without end."""

    def take(self) -> None:
        hoard = []
        while True:
            hoard.append(os.open(__file__, os.O_RDONLY))


class StartsManyThreads(Takes):
    """Starts threads without end."""

    def take(self) -> None:
        end = threading.Event()
        try:
            while True:
                threading.Thread(target=end.wait, daemon=True).start()
        finally:
            end.set()


class Recurses(Takes):
    """Runs out of stack."""

    def take(self) -> None:
        sys.setrecursionlimit(1 << 30)
        threading.stack_size(0)
        faulthandler.disable()

        class Deep:
            def __getattr__(self, name: str) -> Any:
                return getattr(self, name + "x")

        _ = Deep().a


class Crashes(Takes):
    """Ends by a signal of its own."""

    def take(self) -> None:
        resource.getrlimit(resource.RLIMIT_CORE)
        os.kill(os.getpid(), signal.SIGSEGV)


class Exits(Takes):
    """Ends as if all were well."""

    def take(self) -> None:
        os._exit(0)


class Stops(Takes):
    """Does nothing any more, and ignores every signal that can be ignored."""

    def take(self) -> None:
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        os.kill(os.getpid(), signal.SIGSTOP)


class HoldsInterpreter(Takes):
    """Lets no other thread of its process run."""

    def take(self) -> None:
        sys.setswitchinterval(1e9)
        while True:
            pass


class FloodsLog(Takes):
    """Prints without end."""

    def take(self) -> None:
        while True:
            os.write(1, _PIECE)


class Babbles(Takes):
    """Writes anything in place of a reply."""

    def take(self) -> None:
        for number in range(3, 64):
            try:
                os.write(number, b"\x7f" * 64)
            except OSError:
                continue


class ClosesPipes(Takes):
    """Closes everything that is open."""

    def take(self) -> None:
        os.closerange(0, 64)
