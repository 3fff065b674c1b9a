"""Policies that read what they must not see."""

from __future__ import annotations

import ctypes
import os
import sys
import tempfile
from pathlib import Path

from tests.evaluator.policy.hostile.base import Hostile, Tries, syscall, wide


class ReadsScenarios(Hostile):
    """Reads the scenario lists, through every path that leads to them."""

    harmless = 1  # a link of its own that leads nowhere

    def tries(self) -> Tries:
        from rema_data.manifests import manifests_dir

        folder = manifests_dir()
        files = [path for path in folder.rglob("*") if path.is_file()] or list(folder.glob("scenarios/v1/*.parquet"))
        names = ("manifest.json", "grasp_test.parquet", "grasp_val.parquet", "push_test.parquet")
        files += [folder / "scenarios" / "v1" / name for name in names]
        around = [Path("/proc/self/root", *path.parts[1:]) for path in files]
        history = [folder.parent / ".git" / "HEAD", folder.parent / ".git" / "packed-refs"]
        link = Path(tempfile.gettempdir(), "link")
        link.unlink(missing_ok=True)
        yield lambda: os.symlink(folder, link)  # allowed, and of no use: counted below
        for path in (*files, *around, *history, link / "scenarios" / "v1" / "manifest.json"):
            yield lambda path=path: path.read_bytes()[:1]
        yield lambda: os.link(files[0], Path(tempfile.gettempdir(), "hard"))


class ReadsOtherInstallations(Hostile):
    """Reads the scenario lists of every installation of rema that its environment leads to."""

    def tries(self) -> Tries:
        places = [Path(entry) for entry in (*sys.path, *os.environ.get("PYTHONPATH", "").split(":")) if entry]
        for place in dict.fromkeys(places):
            for lists in (place / "manifests", place / "rema_data" / "_manifests"):
                for name in ("manifest.json", "grasp_test.parquet", "push_test.parquet"):
                    yield lambda lists=lists, name=name: (lists / "scenarios" / "v1" / name).read_bytes()
            for name in ("HEAD", "packed-refs", "config"):
                yield lambda place=place, name=name: (place / ".git" / name).read_bytes()


class InspectsEvaluator(Hostile):
    """Reads the memory, the environment and the open files of the process that started it."""

    def tries(self) -> Tries:
        evaluator = Path("/proc", str(os.getppid()))
        for name in ("mem", "environ", "maps", "cmdline", "fd/0", "stack", "auxv", "cwd", "root"):
            yield lambda name=name: os.close(os.open(evaluator / name, os.O_RDONLY))
        yield lambda: os.listdir(evaluator / "fd")
        yield lambda: self.call("ptrace", 2, os.getppid(), 0, 0)
        buffer = ctypes.create_string_buffer(8)
        vector = (ctypes.c_size_t * 2)(ctypes.addressof(buffer), 8)
        yield lambda: self.call("process_vm_readv", os.getppid(), vector, 1, vector, 1, 0)


class ReadsOtherProcesses(Hostile):
    """Reads what the kernel tells about other processes and about all of them."""

    def tries(self) -> Tries:
        for name in ("1/environ", "1/stat", "1/cmdline", "locks", "keys", "key-users", "sysvipc/shm", "modules",
                     "kcore", "kmsg", "sched_debug", "timer_list", "1/fd", "1/root/etc/passwd"):  # fmt: skip
            yield lambda name=name: os.close(os.open(f"/proc/{name}", os.O_RDONLY))
        yield lambda: os.listdir("/proc")


class ReadsSecrets(Hostile):
    """Reads what belongs to the user and to the machine."""

    def tries(self) -> Tries:
        homes = ("/root", "/home", *(str(path) for path in Path(sys.prefix).parents[-3:-1]))
        for path in ("/etc/shadow", "/etc/ssh", "/etc/hostname", "/var/log", "/var/lib", "/srv", "/boot", "/dev/shm"):
            yield lambda path=path: os.close(os.open(path, os.O_RDONLY))
        for home in homes:
            yield lambda home=home: os.listdir(home)
            for name in (".ssh/id_rsa", ".netrc", ".bash_history", ".aws/credentials"):
                yield lambda home=home, name=name: Path(home, name).read_bytes()


class ReadsBesideItself(Hostile):
    """Looks for other policies, their copies and their temporary folders, and for runs."""

    def tries(self) -> Tries:
        temporary, code = Path(tempfile.gettempdir()), Path(__file__)
        for place in (temporary.parent, *code.parents[5:8], Path("/tmp"), Path("/var/tmp")):
            yield lambda place=place: os.listdir(place)
        yield lambda: os.listdir(f"/proc/{os.getppid()}/cwd/runs")
        yield lambda: os.listdir("/proc/self/cwd/../..")


class ReadsThroughHandles(Hostile):
    """Opens files by handles, trees and other roots in place of paths."""

    def tries(self) -> Tries:
        handle = ctypes.create_string_buffer(160)
        yield lambda: syscall("name_to_handle_at", -100, b"/etc/hostname", handle, handle, 0)
        yield lambda: syscall("open_by_handle_at", -100, handle, 0)
        yield lambda: syscall("open_tree", -100, b"/", 0)
        yield lambda: os.open("/", os.O_RDONLY)
        yield lambda: os.listdir("/proc/self/root")
        yield lambda: syscall("pidfd_getfd", -1, 0, 0)


class ProfilesOthers(Hostile):
    """Measures other processes with the tools of the kernel."""

    def tries(self) -> Tries:
        yield lambda: syscall("perf_event_open", None, -1, 0, -1, 0)
        yield lambda: syscall("bpf", 0, None, 0)
        yield lambda: syscall("userfaultfd", 1)
        yield lambda: syscall("kcmp", os.getpid(), os.getppid(), 0, wide(0), wide(0))
        yield lambda: syscall("process_madvise", -1, None, wide(0), 0, 0)
        yield lambda: syscall("move_pages", os.getppid(), wide(0), None, None, None, 0)
        yield lambda: syscall("syslog", 10, None, 0)
        yield lambda: os.sched_getscheduler(os.getppid())
        yield lambda: os.getpriority(os.PRIO_PROCESS, os.getppid())


class ReadsPageCache(Hostile):
    """Asks which parts of a file are in memory, as others left it."""

    def tries(self) -> Tries:
        import mmap

        with open(os.__file__, "rb") as file, mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ) as view:
            seen = ctypes.create_string_buffer(64)
            start = ctypes.addressof(ctypes.c_char.from_buffer(bytearray(view[:1])))
            yield lambda: syscall("mincore", wide(start & ~4095), wide(4096), seen)
            yield lambda: syscall("cachestat", file.fileno(), seen, seen, 0)
