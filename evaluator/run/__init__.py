"""What makes a run checkable by a stranger: its action log, the tree over its rows, its seal, and a signature.

::

    header      run.json
    actions     actions.bin, two bytes for every step of every episode
    merkle      one hash over all rows, and the short proof that a row is under it
    rows        rows of episodes.parquet as bytes that can be hashed
    proof       that proof as a file
    seal        digests in run.json of itself and of the files beside it
    check       which of them no longer agree, and in which row
    signature   an Ed25519 signature over run.json, and through the seal over everything

``evaluator.replay`` goes further and simulates the recorded actions again.
"""
