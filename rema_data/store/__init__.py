"""The store: a release is a set of blocks, a block is two tables and a group of maps.

Read in this order: ``keys`` (which block), ``columns`` (what is stored), ``tables`` (records to rows and back),
``maps`` (arrays), ``block``.
"""
