"""Messages for a policy that cannot be loaded: the last lines that it printed, and how to fix it."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evaluator.policy.sandbox.isolation import Isolation

__all__ = ["LoadFailure", "conversion_command", "printable", "load_hint"]

_SHOWN = 2000  # characters
_UNPICKLING = "_pickle.UnpicklingError"
_DENIED = "builtins.PermissionError"
_OWN = "rema_data.errors.RemaError"
_PICKLES = (".pt", ".pth", ".ckpt", ".pkl", ".bin")
_FILES = 5
"""Number of pickles of a folder that are named."""


def conversion_command(path: Path, *, trust: bool = False) -> str:
    """What turns the weights in a pickle into safetensors, for a shell.

    Parameters
    ----------
    path : Path
    trust : bool
        Whether the pickle may run code when it is opened; the user has to choose that.
    """
    words = ["python", "-m", "evaluator.policy.conversion", str(path), *(["--trust"] if trust else [])]
    return shlex.join(words)


def printable(said: object) -> str:
    """Text of a policy, fit for a terminal and for a record: no control characters, no lone surrogates, not long.

    A value that is not text (a hostile policy writes its own replies) is shown as its type.
    """
    text = said if isinstance(said, str) else f"({type(said).__name__})"
    text = text[:_SHOWN].encode(errors="backslashreplace").decode()
    return "".join(c if c.isprintable() or c in "\n\t" else ascii(c)[1:-1] for c in text)


@dataclass(frozen=True, slots=True)
class LoadFailure:
    """Why a policy cannot be used, as its process or the evaluator reports it.

    Attributes
    ----------
    message : str
        What is wrong, in a line.
    where : str
        File and line in the submitter's code where it was raised.
    trace : str
        The last lines of the traceback.
    kinds : tuple of str
        Types (``module.name``) of what was raised, with their bases and those of its causes.
    """

    message: str
    where: str = ""
    trace: str = ""
    kinds: tuple[str, ...] = ()

    @property
    def explains_itself(self) -> bool:
        """Whether it is an error of rema, whose last line says what to do."""
        return _OWN in self.kinds

    @staticmethod
    def of(header: dict[str, Any]) -> LoadFailure:
        """From the reply of a process; no value in it is trusted to have the right type."""
        kinds = header.get("kinds")
        return LoadFailure(
            printable(header.get("message", "could not be loaded")),
            printable(header.get("where", "")),
            printable(header.get("traceback", "")),
            tuple(kind for kind in kinds if isinstance(kind, str)) if isinstance(kinds, list) else (),
        )


def load_hint(
    failure: LoadFailure, place: str, printed: str, isolation: Isolation | None, checkpoint: Path | None
) -> str:
    """Lines below the message: what was raised, and how to fix it.

    Parameters
    ----------
    failure : LoadFailure
    place : str
        File, or file and line, to fix.
    printed : str
        What the policy printed; shown where there is no traceback.
    isolation : Isolation or None
        None where the process did not get so far.
    checkpoint : Path or None
        What the policy had to load.
    """
    lines = [printable((failure.trace or printed)[-_SHOWN:]).strip()]
    if _UNPICKLING in failure.kinds:
        lines.append(
            "a pickle can run any code when it is opened, so only tensors are read from it; if you trust its "
            "author, convert its weights once, and load the safetensors instead:"
        )
        lines += [conversion_command(path, trust=True) for path in _pickles(checkpoint)]
    if _DENIED in failure.kinds and isolation is not None and isolation.level != "L1":
        lines.append(
            "a policy reads its own folder and its --checkpoint, writes its temporary folder, and starts no process "
            "and no connection: docs/threat_model.md"
        )
    lines.append(f"to fix this, edit {place} and run the same command again")
    return "\n".join(line for line in lines if line)


def _pickles(checkpoint: Path | None) -> list[Path]:
    """The files that a policy may have tried to open."""
    if checkpoint is not None and checkpoint.is_file():
        return [checkpoint]
    if checkpoint is None:
        return [Path("FILE.pt")]
    found = sorted(path for path in checkpoint.rglob("*") if path.suffix in _PICKLES and path.is_file())
    return found[:_FILES] or [checkpoint / "FILE.pt"]
