"""Recursive collection: a plan of rounds is played by behaviour policies and sealed as a release.

Read in this order: ``plan`` (what is asked), ``collect`` (from plan to release), ``play`` (observe, ask, simulate),
``chunk`` and ``work`` (what survives a kill), ``command`` (``rema collect``).
"""
