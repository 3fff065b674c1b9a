"""What a submitter is told when a policy cannot be used: the last lines that it printed, and what mends it."""

from __future__ import annotations

import shlex
from pathlib import Path

from evaluator.policy.isolation import Isolation

__all__ = ["conversion_command", "printable", "refusal_hint"]

_SHOWN = 2000  # characters


def conversion_command(path: Path) -> str:
    """What turns the weights in a pickle into safetensors, for a shell."""
    code = (
        "import torch, safetensors.torch as s; "
        f"s.save_file(torch.load({str(path)!r}, weights_only=True), {str(path.with_suffix('.safetensors'))!r})"
    )
    return f"python -c {shlex.quote(code)}"


def printable(said: object) -> str:
    """What a policy said, fit for a terminal and for a record: no control characters, no lone surrogates, not long.

    What should be text and is not (a hostile policy writes its own replies) is shown as its type.
    """
    text = said if isinstance(said, str) else f"({type(said).__name__})"
    text = text[:_SHOWN].encode(errors="backslashreplace").decode()
    return "".join(c if c.isprintable() or c in "\n\t" else ascii(c)[1:-1] for c in text)


def refusal_hint(message: str, place: str, printed: str, isolation: Isolation | None) -> str:
    """Lines below a refusal.

    Parameters
    ----------
    message : str
        What is wrong: an exception of the policy begins with its type.
    place : str
        File, or file and line, that is to be mended.
    printed : str
        Traceback, or what it printed.
    isolation : Isolation or None
        None where its process did not come as far.
    """
    lines = [printable(printed[-_SHOWN:]).strip()]
    if message.startswith(("UnpicklingError", "_pickle.UnpicklingError")):
        lines.append(
            "a pickle can run any code when it is opened, so only tensors are read from it; convert the weights once:\n"
            + conversion_command(Path("weights.pt"))
        )
    if message.startswith("PermissionError") and isolation is not None and isolation.level != "L1":
        lines.append(
            "a policy reads its own folder and its --checkpoint, writes its temporary folder, and starts no process "
            "and no connection: docs/threat_model.md"
        )
    lines.append(f"mend {place} and run the same command again")
    return "\n".join(line for line in lines if line)
