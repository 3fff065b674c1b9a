"""What a policy prints: drained as fast as it comes, and only its beginning and its end are kept."""

from __future__ import annotations

import fcntl
import logging
import os
import select
import threading
from pathlib import Path

from rema_data.storage import write_atomic

__all__ = ["CappedOutput", "printable"]

_LOG = logging.getLogger(__name__)
_CHUNK = 1 << 20
_POLL_S = 0.2
_SHOWN = 2000  # characters


class CappedOutput:
    """A pipe for a process's stdout and stderr that never fills, and a log file that never grows large.

    ``head`` and ``tail`` bytes are kept of the beginning and of the end. The log file at ``path`` is created if
    anything is printed (None: memory only). What it held before stays in it, up to the last ``head + tail`` bytes.
    """

    def __init__(self, path: Path | None, head: int, tail: int) -> None:
        self._head_limit, self._tail_limit = head, tail
        self._head, self._tail = bytearray(), bytearray()
        self._total = 0
        self._path = path
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._threads: list[threading.Thread] = []

    def open_pipe(self) -> int:
        """Write end of a new pipe (a restarted process gets its own); close it after the process was started."""
        reader, writer = os.pipe()
        if hasattr(fcntl, "F_SETPIPE_SZ"):
            fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, _CHUNK)
        self._closing.clear()
        thread = threading.Thread(target=self._drain, args=(reader,), daemon=True)
        thread.start()
        self._threads = [*filter(threading.Thread.is_alive, self._threads), thread]
        return writer

    def _drain(self, reader: int) -> None:
        """Read until the end of the pipe, or until ``settle`` if a process that escaped holds it open."""
        try:
            while True:
                ready, _, _ = select.select([reader], [], [], _POLL_S)
                if not ready:
                    if self._closing.is_set():
                        return
                    continue
                chunk = os.read(reader, _CHUNK)
                if not chunk:
                    return
                self._keep(chunk)
                if self._closing.is_set() and self._total > self._head_limit:
                    return
        finally:
            os.close(reader)

    def _keep(self, chunk: bytes) -> None:
        with self._lock:
            self._total += len(chunk)
            room = self._head_limit - len(self._head)
            if room > 0:
                self._head += chunk[:room]
                chunk = chunk[room:]
            if chunk:
                self._tail += chunk[-self._tail_limit :]
                del self._tail[: -self._tail_limit]

    def settle(self) -> None:
        """Wait for the pipes of ended processes, and write the log file."""
        self._closing.set()
        for thread in self._threads:
            thread.join(timeout=5 * _POLL_S)
        self._threads.clear()
        if self._path is None or not self._total:
            return
        try:
            earlier = self._path.read_bytes()[-self._head_limit - self._tail_limit :] if self._path.exists() else b""
            write_atomic(self._path, earlier + self.text().encode())
        except OSError as error:  # a run does not fail for its log
            _LOG.warning("what the policy printed is lost: %s", error)

    @property
    def total(self) -> int:
        """Bytes printed so far."""
        return self._total

    def text(self) -> str:
        """The kept output, with a line that says how much was left out."""
        with self._lock:
            left_out = self._total - len(self._head) - len(self._tail)
            middle = f"\n... {left_out} bytes left out ...\n" if left_out > 0 else ""
            return self._head.decode(errors="replace") + middle + self._tail.decode(errors="replace")


def printable(text: object) -> str:
    """Text of a policy, fit for a terminal and for a record: no control characters, no lone surrogates, not long.

    A value that is not text (a hostile policy writes its own replies) is shown as its type.
    """
    text = text if isinstance(text, str) else f"({type(text).__name__})"
    text = text[:_SHOWN].encode(errors="backslashreplace").decode()
    return "".join(c if c.isprintable() or c in "\n\t" else ascii(c)[1:-1] for c in text)
