"""A small collection in the real world, in a process of its own: three episodes a chunk, so there is much to kill."""

from __future__ import annotations

import sys
from pathlib import Path

from baselines.rounds.collect import collect
from baselines.rounds.plan import load_plan

if __name__ == "__main__":
    plan, output, engine = sys.argv[1:]
    collect(load_plan(Path(plan)), Path(output), engine=engine, workers=2, chunk_episodes=3)
