"""Releases: sealed sets of blocks, each named by the hash of its manifest.

Read in this order: ``manifest`` (the contract), ``registry`` (what is published), ``folder`` (what is here), ``seal``.
"""
