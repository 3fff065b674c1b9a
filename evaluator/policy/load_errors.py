"""Messages for a policy that cannot be loaded: the last lines that it printed, and how to fix it."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from evaluator.policy.output import printable
from evaluator.policy.sandbox_hints import Cause

__all__ = ["LoadFailure", "conversion_command", "load_hint"]

_SHOWN = 2000  # characters
_UNPICKLING = "_pickle.UnpicklingError"
_OWN = "rema_data.errors.RemaError"
_PICKLES = (".pt", ".pth", ".ckpt", ".pkl", ".bin")
_FILES = 5  # pickles of a folder that are named


def conversion_command(path: Path, *, trust: bool = False) -> str:
    """Shell command that turns the weights in a pickle into safetensors; with ``trust`` the pickle may run code."""
    words = ["python", "-m", "evaluator.policy.conversion", str(path), *(["--trust"] if trust else [])]
    return shlex.join(words)


@dataclass(frozen=True, slots=True)
class LoadFailure:
    """Why a policy cannot be used, as its process or the evaluator reports it."""

    message: str  # one line
    where: str = ""  # file and line in the submitter's code where it was raised
    trace: str = ""  # the last lines of the traceback
    kinds: tuple[str, ...] = ()  # types (``module.name``) of the exception and of its causes, with their bases
    cause: Cause = field(default_factory=Cause)

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
            Cause.of(header),
        )


def load_hint(failure: LoadFailure, place: str, printed: str, checkpoint: Path | None, sandbox: str = "") -> str:
    """Lines below the message: the traceback, or else what the policy ``printed``, and how to fix it at ``place``.

    ``sandbox`` is what the sandbox has to do with it (``sandbox_hint``).
    """
    lines = [printable((failure.trace or printed)[-_SHOWN:]).strip()]
    if _UNPICKLING in failure.kinds:
        lines.append(
            "a pickle can run any code when it is opened, so only tensors are read from it; if you trust its "
            "author, convert its weights once, and load the safetensors instead:"
        )
        lines += [conversion_command(path, trust=True) for path in _pickles(checkpoint)]
    if sandbox:
        lines.append(f"sandbox: {sandbox}")
    lines.append(f"to fix this, edit {place} and run the same command again")
    return "\n".join(line for line in lines if line)


def _pickles(checkpoint: Path | None) -> list[Path]:
    if checkpoint is not None and checkpoint.is_file():
        return [checkpoint]
    if checkpoint is None:
        return [Path("FILE.pt")]
    found = sorted(path for path in checkpoint.rglob("*") if path.suffix in _PICKLES and path.is_file())
    return found[:_FILES] or [checkpoint / "FILE.pt"]
