"""``python -m evaluator.cli``: the same as ``rema``."""

from __future__ import annotations

from evaluator.cli.start import main

main()
