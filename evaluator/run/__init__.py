"""A run folder: what a process writes there, and its only reader (``reading.read_run``, which makes a ``Run``).

``records`` are the journals while it runs; ``tables``, ``summary``, ``actions`` and ``header`` (run.json) are the
finished run, ``seal`` their digest. ``entry`` is an entry of the leaderboard: what was run, and the actions;
``derived`` is what these give. ``evaluator.replay`` simulates the actions again.
"""
