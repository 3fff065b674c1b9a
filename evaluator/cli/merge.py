"""``rema merge``: the shards of one run become one run."""

from __future__ import annotations

from pathlib import Path

import click

__all__ = ["merge"]


@click.command()
@click.argument("shards", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--output", required=True, type=click.Path(path_type=Path), help="Folder of the whole run.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary object alone.")
def merge(shards: tuple[Path, ...], output: Path, as_json: bool) -> None:
    """Merge SHARDS, the run folders of all shards of one evaluation (`rema evaluate --shard I/N`).

    They must be of the same policy, protocol, scenario list and simulator, without a gap and without an overlap. The
    whole run has the same results.parquet, byte for byte, as one that was never divided.
    """
    # Imported here, so that a mistyped option is answered at once.
    from evaluator.cli.result import print_result
    from evaluator.runner.merge import merge_runs

    result = merge_runs(shards, output)
    print_result(result.summary, result.folder, as_json)
