"""Policies that leave something behind for their next process, or for the next run."""

from __future__ import annotations

import fcntl
import glob
import os
import socket
import sys
import sysconfig
import tempfile
from pathlib import Path

from tests.evaluator.policy.hostile.base import Hostile, Tries, syscall

_FS_IOC_SETFLAGS, _FS_IOC_FSSETXATTR, _FS_IOC_SETVERSION, _FICLONE = 0x40086602, 0x401C5820, 0x40087602, 0x40049409


class ChangesFiles(Hostile):
    """Changes its own code and weights, and leaves things behind outside its folder."""

    def tries(self) -> Tries:
        weights = [] if self.checkpoint is None else [self.checkpoint]
        for path in (Path(__file__), *weights):
            yield lambda path=path: os.close(os.open(path, os.O_WRONLY))
            yield lambda path=path: os.truncate(path, path.stat().st_size)
            yield lambda path=path: path.chmod(path.stat().st_mode)
            yield lambda path=path: os.rename(path, path)
        for folder in ("/tmp", "/dev/shm", "/var/tmp", str(Path(__file__).parent)):
            yield lambda folder=folder: Path(folder, "rema-hostile").write_text("here")


class SetsFileTimes(Hostile):
    """Writes into the times of files that it can read, and of its own."""

    def tries(self) -> Tries:
        own = Path(tempfile.gettempdir(), "times")
        own.write_text("")
        for path in (Path(os.__file__), Path(__file__), own, own.parent):
            times = (path.stat().st_atime_ns, path.stat().st_mtime_ns)
            yield lambda path=path, times=times: os.utime(path, ns=times)
            yield lambda path=path: self.call("utimensat", -100, bytes(path), None, 0)
            yield lambda path=path: self.call("utime", bytes(path), None)
        yield lambda: self.call("futimesat", -100, bytes(own), None)
        number = os.open(own, os.O_RDWR)
        yield lambda: self.call("futimens", number, None)
        os.close(number)


class ReadsToMark(Hostile):
    """Reads files so that the time of their last reading is noted; whoever comes next looks at it."""

    def tries(self) -> Tries:
        names = sorted(glob.glob(f"{sysconfig.get_path('stdlib')}/*.py"))[:200]
        for name in (*names, *sorted(glob.glob("/usr/share/zoneinfo/*"))[:100]):
            yield lambda name=name: self._mark(name)

    def _mark(self, name: str) -> None:
        before = os.stat(name).st_atime_ns
        with open(name, "rb") as file:
            file.read(1)
        if os.stat(name).st_atime_ns == before:
            raise OSError(name)


class SetsExtendedAttributes(Hostile):
    """Attributes of files in which anything can be written."""

    def tries(self) -> Tries:
        own = Path(tempfile.gettempdir(), "attributes")
        own.write_text("")
        for path in (own, Path(__file__), Path(os.__file__)):
            yield lambda path=path: os.setxattr(path, "user.rema", b"here")
            yield lambda path=path: os.removexattr(path, "user.rema")
            yield lambda path=path: syscall("setxattrat", -100, bytes(path), 0, None, None, 0)


class SetsModes(Hostile):
    """Modes and owners of files, by every call that sets them."""

    def tries(self) -> Tries:
        own = Path(tempfile.gettempdir(), "modes")
        own.write_text("")
        number = os.open(own, os.O_RDWR)
        for path in (own, Path(__file__)):
            mode = path.stat().st_mode & 0o7777
            yield lambda path=path, mode=mode: os.chmod(path, mode)
            yield lambda path=path: os.chown(path, -1, -1)
            yield lambda path=path: os.lchown(path, -1, -1)
            yield lambda path=path, mode=mode: syscall("fchmodat2", -100, bytes(path), mode, 0)
        yield lambda: os.fchmod(number, own.stat().st_mode & 0o7777)
        yield lambda: os.fchown(number, -1, -1)
        os.close(number)


class SetsFlags(Hostile):
    """Flags of files, by ioctl."""

    def tries(self) -> Tries:
        own = Path(tempfile.gettempdir(), "flags")
        own.write_text("x")
        for path in (own, Path(__file__), Path(os.__file__)):
            number = os.open(path, os.O_RDONLY)
            for command in (_FS_IOC_SETFLAGS, _FS_IOC_FSSETXATTR, _FS_IOC_SETVERSION, _FICLONE):
                yield lambda number=number, command=command: fcntl.ioctl(number, command, number)
            os.close(number)


class WritesCaches(Hostile):
    """Writes where programs keep what they need again."""

    def tries(self) -> Tries:
        places = ["/var/tmp", "/var/cache", "/run", "/dev/shm", os.path.expanduser("~root"), "/root/.cache"]
        places += [sys.prefix, sysconfig.get_path("purelib"), str(Path(os.__file__).parent / "__pycache__")]
        places += [str(Path(__file__).parent), str(Path(tempfile.gettempdir()).parent), "/proc/self/cwd/.."]
        for place in places:
            yield lambda place=place: Path(place, "rema-hostile").write_text("here")
            yield lambda place=place: Path(place, "rema-hostile-folder").mkdir()


class MovesFilesOut(Hostile):
    """Makes a file in its own folder, and another name for it outside."""

    def tries(self) -> Tries:
        own = Path(tempfile.gettempdir(), "out")
        own.write_text("here")
        for place in ("/tmp", "/var/tmp", str(Path(__file__).parent), str(Path(tempfile.gettempdir()).parent)):
            yield lambda place=place: os.link(own, f"{place}/rema-hostile")
            yield lambda place=place: os.rename(own, f"{place}/rema-hostile")
            yield lambda place=place: os.symlink(own, f"{place}/rema-hostile")
            yield lambda place=place: os.close(os.open(place, os.O_TMPFILE | os.O_RDWR))


class NamesTheMachine(Hostile):
    """Names and settings of the kernel that outlive a process."""

    def tries(self) -> Tries:
        name = socket.gethostname().encode()
        yield lambda: self.call("sethostname", name, len(name))
        yield lambda: self.call("setdomainname", None, -1)
        own = [f"/proc/self/{name}" for name in ("oom_score_adj", "comm", "timerslack_ns", "coredump_filter")]
        for path in (*own, "/proc/sys/kernel/hostname", "/sys/kernel/mm/transparent_hugepage/enabled"):
            yield lambda path=path: os.close(os.open(path, os.O_WRONLY))
        yield lambda: syscall("swapon", None, 0)
        yield lambda: syscall("quotactl", -1, None, 0, None)
        yield lambda: self.call("acct", b"/absent/rema")
