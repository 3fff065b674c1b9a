"""Scripts that measure what the documentation claims. Run one with ``python benchmarks/NAME.py``; see its docstring."""
