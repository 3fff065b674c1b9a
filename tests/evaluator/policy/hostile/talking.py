"""Policies that talk to a process outside, or receive anything from one."""

from __future__ import annotations

import ctypes
import fcntl
import os
import resource
import signal
import socket
import struct
import subprocess
import tempfile
import time
from pathlib import Path

from tests.evaluator.policy.hostile.base import Hostile, Tries, syscall, wide

_F_SETSIG, _F_SETLEASE, _F_NOTIFY, _F_OFD_SETLK = 10, 1024, 1026, 37
_TIOCSTI = 0x5412


class SignalsEvaluator(Hostile):
    """Signals the process that started it, and lowers what that may use."""

    def tries(self) -> Tries:
        evaluator = os.getppid()
        for number in (0, signal.SIGCONT):
            yield lambda number=number: os.kill(evaluator, number)
            yield lambda number=number: os.killpg(os.getpgid(evaluator), number)
        yield lambda: resource.prlimit(evaluator, resource.RLIMIT_CORE, (0, 0))
        yield lambda: signal.pidfd_send_signal(os.pidfd_open(evaluator), 0)
        yield lambda: syscall("tkill", evaluator, 0)


class OpensSockets(Hostile):
    """Opens a socket of every kind."""

    def tries(self) -> Tries:
        families = (socket.AF_INET, socket.AF_INET6, socket.AF_UNIX, socket.AF_NETLINK, socket.AF_PACKET)
        for family in (*families, socket.AF_VSOCK, socket.AF_ALG):
            for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM, socket.SOCK_RAW):
                yield lambda family=family, kind=kind: socket.socket(family, kind).close()
        yield lambda: socket.socketpair()
        yield lambda: syscall("io_uring_setup", 1, None)


class UsesInheritedSockets(Hostile):
    """Sends and receives on everything that is open, in case it is a socket."""

    def tries(self) -> Tries:
        for number in range(16):
            yield lambda number=number: syscall("sendmsg", number, None, 0)
            yield lambda number=number: syscall("recvfrom", number, None, wide(0), 0, None, None)
            yield lambda number=number: syscall("connect", number, None, 0)
        for number in range(3, 64):
            yield lambda number=number: self._is_foreign(number)

    def _is_foreign(self, number: int) -> None:
        """Whether something is open that is neither a pipe nor its own; an error where not."""
        target = os.readlink(f"/proc/self/fd/{number}")
        if not target.startswith(("pipe:", "anon_inode:[event", "/")):
            return
        raise OSError(target)


class UsesAbstractSockets(Hostile):
    """Meets another process at a name that is in no folder."""

    def tries(self) -> Tries:
        def meet() -> None:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
                end.bind("\0rema-hostile")

        yield meet
        yield lambda: socket.socket(fileno=os.dup(0)).connect("\0rema-hostile")
        yield lambda: socket.create_connection(("127.0.0.1", 9), timeout=1)


class SharesMemory(Hostile):
    """Memory that another process can map."""

    def tries(self) -> Tries:
        yield lambda: self.call("shmget", 0, 0, 0)
        yield lambda: self.call("shmat", -1, None, 0)
        yield lambda: self.call("shm_open", b"/rema-hostile", os.O_CREAT | os.O_RDWR, 0o600)
        yield lambda: os.memfd_create("hostile")
        yield lambda: syscall("memfd_secret", 0)
        yield lambda: Path("/dev/shm/rema-hostile").write_text("here")


class UsesQueues(Hostile):
    """Queues and semaphores of the kernel."""

    def tries(self) -> Tries:
        yield lambda: self.call("mq_open", b"/rema-absent", os.O_RDONLY)
        yield lambda: self.call("msgget", 0x52454D41, 0)
        yield lambda: self.call("msgrcv", -1, None, wide(0), wide(0), 0)
        yield lambda: self.call("semget", 0, -1, 0)
        yield lambda: self.call("semop", -1, None, wide(0))


class LocksFiles(Hostile):
    """Locks of files that others can read: another process sees whether one is held."""

    def tries(self) -> Tries:
        number = os.open(os.__file__, os.O_RDONLY)
        record = struct.pack("hhqqi4x", fcntl.F_RDLCK, 0, 0, 1, 0)
        yield lambda: fcntl.flock(number, fcntl.LOCK_SH | fcntl.LOCK_NB)
        yield lambda: fcntl.lockf(number, fcntl.LOCK_SH | fcntl.LOCK_NB)
        yield lambda: fcntl.fcntl(number, _F_OFD_SETLK, record)
        yield lambda: fcntl.fcntl(number, fcntl.F_GETLK, record)
        yield lambda: fcntl.fcntl(number, _F_SETLEASE, fcntl.F_RDLCK)
        os.close(number)


class WatchesFiles(Hostile):
    """Is told by the kernel when others open or change files."""

    def tries(self) -> Tries:
        number = os.open(tempfile.gettempdir(), os.O_RDONLY)
        yield lambda: self.call("inotify_init")
        yield lambda: self.call("inotify_add_watch", -1, b"/usr", 1)
        yield lambda: self.call("fanotify_init", 0, 0)
        yield lambda: fcntl.fcntl(number, _F_NOTIFY, 1)
        yield lambda: fcntl.fcntl(number, fcntl.F_SETOWN, os.getpid())
        yield lambda: fcntl.fcntl(number, _F_SETSIG, 0)
        os.close(number)


class UsesKeys(Hostile):
    """Keys of the kernel, which other processes of the user can read."""

    def tries(self) -> Tries:
        yield lambda: syscall("add_key", None, None, None, wide(0), 0)
        yield lambda: syscall("request_key", None, None, None, 0)
        yield lambda: syscall("keyctl", 0, -3, 0)


class UsesTerminals(Hostile):
    """Types into the terminal of the user, and reads from it."""

    def tries(self) -> Tries:
        for name in ("tty", "console", "ptmx", "pts/0", "tty0", "vcs"):
            yield lambda name=name: os.close(os.open(f"/dev/{name}", os.O_RDWR | os.O_NOCTTY))
        for number in range(3):
            yield lambda number=number: fcntl.ioctl(number, _TIOCSTI, 0)


class UsesDevices(Hostile):
    """Devices by which the machine, or another process, can be reached."""

    def tries(self) -> Tries:
        for name in ("mem", "kmsg", "kvm", "fuse", "loop-control", "net/tun", "vhost-net", "uinput", "input", "snd",
                     "log", "mqueue", "hugepages", "userfaultfd", "shm"):  # fmt: skip
            yield lambda name=name: os.close(os.open(f"/dev/{name}", os.O_RDONLY))


class UsesPipes(Hostile):
    """Pipes with names, and the pipes of others."""

    def tries(self) -> Tries:
        for folder in ("/tmp", "/var/tmp", "/dev/shm", str(Path(__file__).parent)):
            yield lambda folder=folder: os.mkfifo(f"{folder}/rema-hostile")
        for number in range(3):
            flags = os.O_RDWR | os.O_NONBLOCK
            yield lambda n=number, flags=flags: os.close(os.open(f"/proc/{os.getppid()}/fd/{n}", flags))
        yield lambda: syscall("vmsplice", -1, None, wide(0), 0)


class StartsProcesses(Hostile):
    """Starts another process."""

    def tries(self) -> Tries:
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


class StartsProcessesByNumber(Hostile):
    """The same by system calls, with flags that look like those of a thread."""

    def tries(self) -> Tries:
        def child(name: str, *arguments: object) -> None:
            if syscall(name, *arguments) == 0:
                os._exit(0)

        yield lambda: child("clone", wide(signal.SIGCHLD), None, None, None, None)
        yield lambda: child("clone", wide(0x11 | 1 << 40), None, None, None, None)
        yield lambda: child("fork")
        yield lambda: syscall("clone3", None, wide(0))
        yield lambda: syscall("clone", wide(0x10000 | 0x10000000), None, None, None, None)
        yield lambda: self.call("execve", None, ctypes.c_void_p(), ctypes.c_void_p())
