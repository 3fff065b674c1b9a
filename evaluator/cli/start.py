"""Where the command ``rema`` begins: it listens to signals before it imports anything that takes time."""

from __future__ import annotations

from rema_data import interrupts

__all__ = ["main"]


def main() -> None:
    """Run the command line."""
    interrupts.listen()
    from evaluator.cli.main import cli

    try:
        cli(prog_name="rema")
    except SystemExit as end:
        if interrupts.requested() and isinstance(end.code, int):
            interrupts.leave(end.code)
        raise
