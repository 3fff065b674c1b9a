"""Forged runs and entries, and what becomes of them: none may gain a rank, or move anybody else's.

    python benchmarks/forgeries.py                       # from runs of random and scripted, grasp, 10,000 episodes
    python benchmarks/forgeries.py --runs runs/random-grasp-conditional runs/scripted-grasp-conditional

Every forgery begins with an honest run and its entry, and knows the format: it seals what it changes. Each is put on a
board that simulates what is not verified (``rema leaderboard --verify``), and every forged run is submitted as well
(``rema submit``). Exits with 6 if one is believed.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.table import Table

from benchmarks.forged import FORGERIES, Forger
from benchmarks.results import finish, parser, target
from evaluator.leaderboard import Board, leaderboard
from evaluator.leaderboard.submission import inspect_run
from evaluator.rollout.backend import Backend
from evaluator.runner import EvaluationConfig, run_evaluation
from rema_data.errors import RemaError


@dataclass(frozen=True)
class Verdict:
    """What became of a forgery."""

    what: str
    believed: bool  # it has a rank, or somebody else's changed
    how: str  # in a few words


def judge(
    what: str, honest: list[Path], folder: Path, *, engine: str = "process", backend: Backend | None = None
) -> Verdict:
    """Forge the best of the honest runs (the first one), and look what the board and a submission make of it."""
    folder.mkdir(parents=True)
    forged = FORGERIES[what](Forger(honest[0], folder))
    before = _board(honest, engine, backend)
    after = _board([*honest, *forged], engine, backend)
    ours = {str(path) for path in honest}
    theirs = [row for row in after.rows if row.source not in ours]
    gains = [f"{row.policy} has rank {row.rank}" for row in theirs if row.rank is not None]
    gains += [f"{path.name} is submitted" for path in forged if path.is_dir() and _submits(path, engine, backend)]
    gains += ["somebody else's place changed"] if _places(before, ours) != _places(after, ours) else []
    if gains:
        return Verdict(what, True, "; ".join(gains))
    reasons = [row.unranked for row in theirs] + [error.message for error in after.refused]
    shown = [remark for remark in after.remarks if "is shown as that one" in remark]
    return Verdict(what, False, (reasons or shown)[0].replace(str(folder), ""))


def _places(board: Board, sources: set[str]) -> dict[str, Any]:
    return {row.source: (row.rank, row.rate, row.ties) for row in board.rows if row.source in sources}


def _board(sources: list[Path], engine: str, backend: Backend | None) -> Board:
    return leaderboard(sources, published=False, simulate=True, engine=engine, backend=backend)


def _submits(folder: Path, engine: str, backend: Backend | None) -> bool:
    try:
        return inspect_run(folder, engine=engine, backend=backend).valid
    except RemaError:
        return False


def main() -> int:
    """Forge, judge, and print a line for each."""
    options = parser(__doc__)
    options.add_argument("--runs", nargs="+", type=Path, help="honest runs over the full list, the best one first")
    arguments = options.parse_args()
    with tempfile.TemporaryDirectory() as made:
        honest = arguments.runs or _honest(Path(made))
        verdicts = [judge(what, honest, Path(made) / str(number)) for number, what in enumerate(FORGERIES)]
    table = Table("forgery", "believed", "what becomes of it", title="forged runs and entries")
    for verdict in verdicts:
        table.add_row(verdict.what, "YES" if verdict.believed else "no", verdict.how)
    believed = [verdict.what for verdict in verdicts if verdict.believed]
    reached = target("forgeries that are believed", "0", f"{len(believed)} of {len(verdicts)}", not believed)
    numbers = {"forgeries": len(verdicts), "believed": believed}
    return finish(arguments, "forgeries", [table], [reached], [], numbers, mismatch=bool(believed))


def _honest(folder: Path) -> list[Path]:
    """Runs of random and scripted over the whole list of grasp: the random policy is the one with a rank to lose."""
    from evaluator.policy import resolve

    found = []
    for name in ("random", "scripted"):
        run_evaluation(EvaluationConfig(resolve(name), "grasp", folder / name))
        found.append(folder / name)
    return found


if __name__ == "__main__":
    sys.exit(main())
