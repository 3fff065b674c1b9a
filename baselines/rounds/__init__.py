"""Recursive collection: behaviour policies play a plan of rounds, and the episodes are sealed as a release.

Read in this order: ``plan`` (what is collected), ``collect`` (from plan to release), ``play`` (observe, ask, simulate),
``work`` (what survives a kill). Then the recursion: ``recursion_plan`` (rounds, and the networks after each),
``recursion`` (stage after stage), ``sealed`` (whether a stage is done). ``command``: ``rema collect``, ``rema rounds``.
"""
