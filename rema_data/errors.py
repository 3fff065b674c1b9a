"""The error tree of rema.

::

    RemaError                       exit code 1
    ├── InputError (ValueError)             2   an argument or a value that cannot be used
    ├── MissingFileError (FileNotFoundError) 2  a file that should be there is not
    ├── IntegrityError (ValueError)         6   bytes that are not the ones the manifest names
    ├── SubmissionError (TypeError)         3   a policy that cannot be loaded or breaks its contract
    ├── RunMismatchError (ValueError)       2   a run folder that belongs to something else
    ├── PolicyFailureError (RuntimeError)   4   a policy that failed on too many episodes
    ├── InfrastructureError (RuntimeError)  5   workers that died on too many episodes
    └── StorageError (OSError)              2   a disk that is full or cannot be written

Every error also inherits the built-in that a newcomer would catch, carries its facts as attributes, and ends with the
command or the edit that fixes it (``hint``). A failed manipulation attempt is data and never one of these.
"""

from __future__ import annotations

from typing import Any, ClassVar

__all__ = [
    "InfrastructureError",
    "InputError",
    "IntegrityError",
    "MissingFileError",
    "PolicyFailureError",
    "RemaError",
    "RunMismatchError",
    "StorageError",
    "SubmissionError",
]


class RemaError(Exception):
    """Root of every error that rema raises on purpose.

    Parameters
    ----------
    message : str
        What is wrong, and where.
    hint : str
        The command or the edit that fixes it.
    **facts
        The values that the message is about, kept as attributes of ``facts``.
    """

    exit_code: ClassVar[int] = 1

    def __init__(self, message: str, *, hint: str = "", **facts: Any) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.facts = facts

    def __str__(self) -> str:
        return f"{self.message}\n{self.hint}" if self.hint else self.message


class InputError(RemaError, ValueError):
    """An argument or a value that cannot be used."""

    exit_code = 2


class MissingFileError(RemaError, FileNotFoundError):
    """A file that should be there is not."""

    exit_code = 2


class IntegrityError(RemaError, ValueError):
    """Bytes that are not the ones the manifest names."""

    exit_code = 6


class SubmissionError(RemaError, TypeError):
    """A policy that cannot be loaded or breaks its contract from the start."""

    exit_code = 3


class RunMismatchError(RemaError, ValueError):
    """A run folder that belongs to another policy, protocol or scenario list."""

    exit_code = 2


class PolicyFailureError(RemaError, RuntimeError):
    """A policy that failed on more episodes than a run tolerates."""

    exit_code = 4


class InfrastructureError(RemaError, RuntimeError):
    """Workers that died on more episodes than a run tolerates."""

    exit_code = 5


class StorageError(RemaError, OSError):
    """A disk that is full, or a folder that cannot be written."""

    exit_code = 2
