"""Recursive collection: a plan of rounds is played by behaviour policies and sealed as a release.

Read in this order: ``plan`` (what is asked), ``collect`` (from plan to release), ``play`` (observe, ask, simulate),
``chunk`` and ``work`` (what survives a kill), ``command`` (``rema collect``). Then the recursion, ``rema rounds``:
``recursion_plan`` (rounds, and the networks after each), ``recursion`` (stage after stage), ``sealed`` (whether a stage
is done), ``notes`` (what it took, and who played), ``recursion_command``.
"""
