"""``rema proof``: show that one episode is part of a run, to a reader who has only the root of the run."""

from __future__ import annotations

import json
from pathlib import Path

import click

from evaluator.cli.output import line, print_json
from rema_data.errors import InputError, MissingFileError

__all__ = ["proof"]


@click.command()
@click.argument("path", type=click.Path(path_type=Path))
@click.option("--episode", type=click.IntRange(min=0), help="Make a proof of this episode of the run PATH.")
@click.option("--root", metavar="HEX", help="Check the proof PATH against the root of a run.")
@click.option("--json", "as_json", is_flag=True, help="With --root: print the proved row as one object.")
def proof(path: Path, episode: int | None, root: str | None, as_json: bool) -> None:
    """Prove one episode of a run (--episode), or check such a proof (--root); exit code 6 where it does not hold.

    A proof is one JSON object: the row, and the hashes on its way to the root.
    """
    if (episode is None) == (root is None):
        raise InputError("give either --episode or --root", hint="rema proof RUN --episode 7 > proof.json")
    from evaluator.run.proof import check_proof, make_proof

    if episode is not None:
        print_json(make_proof(path, episode))
        return
    if not path.is_file():
        raise MissingFileError(f"there is no proof at {path}", hint="check the path", path=str(path))
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not JSON: {error}", hint="make one: rema proof RUN --episode N") from error
    row = check_proof(content, str(root))
    if as_json:
        print_json(row)
    else:
        result = {True: "a success", False: f"a failure ({row.get('failure')})", None: "not measured"}
        line(f"{row.get('scenario')} is part of the run with this root: {result[row.get('success')]}")
