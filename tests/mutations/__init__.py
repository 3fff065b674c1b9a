"""Damaged and forged inputs for every parser: ``mutators`` makes them, ``data`` and ``runs`` list the parsers, and
``trial`` tries them in a process with limited memory and time. ``benchmarks/mutations.py`` prints the table of all.
"""
