"""A run folder: what a process writes there, and its only reader.

::

    records     journals of answers and outcomes, while it runs
    folder      the folder and its lock, for the process that writes
    tables      results.parquet and timings.parquet
    counts      counts, rate and interval, from the rows
    summary     summary.json
    header      run.json
    seal        digests in run.json of itself and of the files beside it
    check       which of them no longer agree, and in which row
    run         Run: what a run is, for all readers
    entry       a run as a submission file of the leaderboard
    reading     read_run: a folder or an entry file as a ``Run``
    actions, merkle, rows, proof, signature
                the action log, the hash tree over the rows, and a signature over run.json

``evaluator.replay`` goes further and simulates the recorded actions again.
"""
