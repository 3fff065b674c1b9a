"""``python -m evaluator.cli``: the same as ``rema``."""

from __future__ import annotations

from evaluator.cli.main import cli

cli(prog_name="rema")
