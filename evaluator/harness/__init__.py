"""Every task in the interfaces of other harnesses: LeRobot, vla-evaluation-harness and Inspect Robots.

``poses`` is the environment that they share, without any of these packages: its observations and actions are those of
an export for LeRobot. Each of the other modules needs the package that it is for, and the extra ``gym``.
"""
