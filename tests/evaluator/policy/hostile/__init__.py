"""Policies that try what a policy must not do, by kind. Run them only in the sandbox.

Most only *try*: every try is harmless where it goes through (it asks, sets what is set, or has arguments that are
refused). They answer a valid action whose angle says how many tries succeeded; 0 is the goal.
"""
