"""How a file can fail to arrive."""

from __future__ import annotations

from http import HTTPStatus

from rema_data.release.manifest import FileEntry

__all__ = ["Faltered", "Refused", "Stopped", "Undelivered", "answered", "retry_after"]

_PASSING = {HTTPStatus.REQUEST_TIMEOUT, HTTPStatus.TOO_EARLY, HTTPStatus.TOO_MANY_REQUESTS}


class Refused(Exception):
    """The source will not deliver this file, not even later; ``absent`` where it only lacks the file."""

    def __init__(self, why: str, *, absent: bool = False) -> None:
        super().__init__(why)
        self.absent = absent


class Faltered(Exception):
    """The source may deliver the file when it is asked again, after ``wait_s`` seconds."""

    def __init__(self, why: str, wait_s: float = 0.0) -> None:
        super().__init__(why)
        self.wait_s = wait_s


class Undelivered(Exception):
    """No source has delivered a file. ``answers`` by source; ``corrupt`` where one of them sent other bytes."""

    def __init__(self, entry: FileEntry, answers: dict[str, str], corrupt: bool) -> None:
        super().__init__(entry.location)
        self.entry = entry
        self.answers = answers
        self.corrupt = corrupt


class Stopped(Exception):
    """The download was interrupted."""


def retry_after(header: str) -> float:
    """Seconds that a server asks to wait; 0 where it names none, or a date."""
    return float(header) if header.isdecimal() else 0.0


def answered(status: int, reason: str, wait: str = "") -> Refused | Faltered:
    """What a web server means by a status of 400 or more; ``wait`` is its header ``Retry-After``."""
    if status == HTTPStatus.NOT_FOUND:
        return Refused("does not have it", absent=True)
    answer = f"answered {status} {reason}".strip()
    if status in _PASSING or status >= HTTPStatus.INTERNAL_SERVER_ERROR:
        return Faltered(answer, retry_after(wait))
    return Refused(answer)
