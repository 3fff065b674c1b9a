"""One episode of a run, with the proof that it is under the run's root: a small JSON file that needs no run folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from evaluator.run.header import RUN_FILE
from evaluator.run.merkle import merkle_proof, root_of_proof
from evaluator.run.reading import read_run
from evaluator.run.rows import row_leaf, row_leaves
from rema_data.errors import InputError, IntegrityError

__all__ = ["check_proof", "make_proof"]

_FORMAT = "rema episode proof 1"


def make_proof(folder: Path, episode: int) -> dict[str, Any]:
    """The row of an episode (position in the scenario list) of a sealed run and its way to the root, ready for JSON.

    Raises InputError without such an episode, MissingFileError or IntegrityError without a sealed, unchanged run.
    """
    run = read_run(folder, with_findings=True)
    if any(finding.file in (RUN_FILE, run.results_path.name) for finding in run.findings):
        raise run.refusal()
    table = run.stored
    if not 0 <= episode < table.num_rows:
        raise InputError(f"{folder} has no episode {episode}", hint=f"give 0 to {table.num_rows - 1}", episode=episode)
    return {
        "format": _FORMAT,
        "merkle_root": run.provenance.merkle_root,
        "episodes": table.num_rows,
        "position": episode,
        "row": table.slice(episode, 1).to_pylist()[0],
        "path": [node.hex() for node in merkle_proof(row_leaves(table), episode)],
    }


def check_proof(proof: Any, root: str) -> dict[str, Any]:
    """The row that a proof from ``make_proof`` is about, after it was found to be under ``root``.

    ``root`` is hexadecimal and from a source that is trusted: not from the proof itself. Raises InputError where it is
    not a proof, IntegrityError where the row is not under the root.
    """
    try:
        if proof["format"] != _FORMAT:
            raise ValueError(f"its format is {proof['format']!r}")
        row, position, count = dict(proof["row"]), int(proof["position"]), int(proof["episodes"])
        path = [bytes.fromhex(node) for node in proof["path"]]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"this is not the proof of an episode: {error}", hint="make one: rema proof RUN --episode N"
        ) from error
    found = root_of_proof(row_leaf(row), position, count, path)
    if found is None or found.hex() != root.lower():
        raise IntegrityError(
            f"episode {position} as the proof shows it is not part of the run with the root {root}",
            hint="ask for another proof, and check where the root comes from",
            expected=root,
            got=None if found is None else found.hex(),
        )
    return row
