"""The bytes of one file from one source, and how a source fails to deliver them."""

from __future__ import annotations

from collections.abc import Callable
from http import HTTPStatus

__all__ = ["Faltered", "Refused", "Stream", "answered"]

_PASSING = {HTTPStatus.REQUEST_TIMEOUT, HTTPStatus.TOO_EARLY, HTTPStatus.TOO_MANY_REQUESTS}


class Refused(Exception):
    """The source will not deliver this file, however often it is asked.

    Attributes
    ----------
    absent : bool
        It just does not have the file, as a mirror of a part of a release.
    """

    def __init__(self, why: str, *, absent: bool = False) -> None:
        super().__init__(why)
        self.absent = absent


class Faltered(Exception):
    """The source may deliver the file when it is asked again.

    Attributes
    ----------
    wait_s : float
        How long it asks us to wait, s.
    """

    def __init__(self, why: str, wait_s: float = 0.0) -> None:
        super().__init__(why)
        self.wait_s = wait_s


class Stream:
    """Bytes of one file from one source.

    Parameters
    ----------
    start : int
    chunk : int
        Bytes of one read, at most.
    readinto : callable
        Fills the beginning of a buffer; the number of bytes, 0 at the end.
    judge : callable
        What an exception of ``readinto`` means: Refused or Faltered.

    Attributes
    ----------
    start : int
        Offset of the first byte: what was asked for, or 0 where a server ignores ranges.
    """

    def __init__(
        self, start: int, chunk: int, readinto: Callable[[memoryview], int], judge: Callable[[Exception], Exception]
    ) -> None:
        self.start = start
        self._chunk = chunk
        self._readinto = readinto
        self._judge = judge

    def readinto(self, space: memoryview) -> int:
        """Put the next bytes, as many as are there, at the beginning of ``space``; how many, 0 at the end.

        Raises
        ------
        Refused, Faltered
        """
        try:
            return self._readinto(space[: self._chunk])
        except Exception as error:
            raise self._judge(error) from error


def answered(status: int, reason: str, retry_after: str | None) -> Refused | Faltered:
    """What a web server means by a status of 400 or more."""
    if status == HTTPStatus.NOT_FOUND:
        return Refused("does not have it", absent=True)
    answer = f"answered {status} {reason}".strip()
    if status in _PASSING or status >= HTTPStatus.INTERNAL_SERVER_ERROR:
        known = retry_after is not None and retry_after.isdecimal()  # a date counts as none
        return Faltered(answer, float(retry_after or 0) if known else 0.0)
    return Refused(answer)
