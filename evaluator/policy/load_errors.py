"""What a submitter is told when a policy cannot be used: the last lines that it printed, and what mends it."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evaluator.policy.sandbox.isolation import Isolation

__all__ = ["Refusal", "conversion_command", "printable", "refusal_hint"]

_SHOWN = 2000  # characters
_UNPICKLING = "_pickle.UnpicklingError"
_DENIED = "builtins.PermissionError"
_OWN = "rema_data.errors.RemaError"
_PICKLES = (".pt", ".pth", ".ckpt", ".pkl", ".bin")
_FILES = 5
"""So many pickles of a folder are named."""


def conversion_command(path: Path, *, trust: bool = False) -> str:
    """What turns the weights in a pickle into safetensors, for a shell.

    Parameters
    ----------
    path : Path
    trust : bool
        Whether the file needs to be opened as a program, which whoever types the command has to want.
    """
    words = ["python", "-m", "evaluator.policy.conversion", str(path), *(["--trust"] if trust else [])]
    return shlex.join(words)


def printable(said: object) -> str:
    """What a policy said, fit for a terminal and for a record: no control characters, no lone surrogates, not long.

    What should be text and is not (a hostile policy writes its own replies) is shown as its type.
    """
    text = said if isinstance(said, str) else f"({type(said).__name__})"
    text = text[:_SHOWN].encode(errors="backslashreplace").decode()
    return "".join(c if c.isprintable() or c in "\n\t" else ascii(c)[1:-1] for c in text)


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a policy cannot be used, as its process or the judge says it.

    Attributes
    ----------
    message : str
        What is wrong, in a line.
    where : str
        File and line, where it was raised in the submitter's code.
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
    def mended_by_its_message(self) -> bool:
        """Whether an error of rema's own was raised, whose last line says what to do."""
        return _OWN in self.kinds

    @staticmethod
    def of(header: dict[str, Any]) -> Refusal:
        """What a process says of itself; nothing in it is trusted to be of any type."""
        kinds = header.get("kinds")
        return Refusal(
            printable(header.get("message", "could not be loaded")),
            printable(header.get("where", "")),
            printable(header.get("traceback", "")),
            tuple(kind for kind in kinds if isinstance(kind, str)) if isinstance(kinds, list) else (),
        )


def refusal_hint(
    refusal: Refusal, place: str, printed: str, isolation: Isolation | None, checkpoint: Path | None
) -> str:
    """Lines below a refusal.

    Parameters
    ----------
    refusal : Refusal
    place : str
        File, or file and line, that is to be mended.
    printed : str
        What it printed, shown where there is no traceback.
    isolation : Isolation or None
        None where its process did not come as far.
    checkpoint : Path or None
        What it was to load.
    """
    lines = [printable((refusal.trace or printed)[-_SHOWN:]).strip()]
    if _UNPICKLING in refusal.kinds:
        lines.append(
            "a pickle can run any code when it is opened, so only tensors are read from it; if you trust whoever made "
            "it, convert its weights once, and load the safetensors instead:"
        )
        lines += [conversion_command(path, trust=True) for path in _pickles(checkpoint)]
    if _DENIED in refusal.kinds and isolation is not None and isolation.level != "L1":
        lines.append(
            "a policy reads its own folder and its --checkpoint, writes its temporary folder, and starts no process "
            "and no connection: docs/threat_model.md"
        )
    lines.append(f"mend {place} and run the same command again")
    return "\n".join(line for line in lines if line)


def _pickles(checkpoint: Path | None) -> list[Path]:
    """The files that a policy may have tried to open."""
    if checkpoint is not None and checkpoint.is_file():
        return [checkpoint]
    if checkpoint is None:
        return [Path("FILE.pt")]
    found = sorted(path for path in checkpoint.rglob("*") if path.suffix in _PICKLES and path.is_file())
    return found[:_FILES] or [checkpoint / "FILE.pt"]
