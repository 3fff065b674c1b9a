"""``rema merge``: the shards of a run become one run."""

from __future__ import annotations

from pathlib import Path

import click

from evaluator.cli.options import json_option

__all__ = ["merge"]


@click.command()
@click.argument("runs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--output", required=True, type=click.Path(path_type=Path), help="Folder of the whole run.")
@json_option
def merge(runs: tuple[Path, ...], output: Path, as_json: bool) -> None:
    """Merge RUNS, the run folders of all shards of one evaluation (`rema evaluate --shard I/N`).

    They must be of the same policy, protocol, scenario list and simulator, without a gap and without an overlap. The
    whole run has the same results.parquet, byte for byte, as one that was never divided. A sample of their actions is
    simulated again; where an outcome is another one, nothing is written.
    """
    # Imported here, so that a mistyped option is answered at once.
    from evaluator.cli.progress import StderrProgress
    from evaluator.cli.result import print_result
    from evaluator.run.reading import read_run
    from evaluator.runner.merge import merge_runs

    with StderrProgress() as progress:
        result = merge_runs(runs, output, progress)
    over_suite = bool(read_run(result.folder).suite)
    print_result(result.summary, result.folder, as_json, over_suite=over_suite)
