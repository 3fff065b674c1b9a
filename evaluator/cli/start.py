"""Where the command ``rema`` begins: it listens to signals before it imports anything that takes time."""

from __future__ import annotations

from rema_data import interrupts

__all__ = ["main"]


def main() -> None:
    """Run the command line."""
    interrupts.listen()
    from evaluator.cli.main import cli

    cli(prog_name="rema")
