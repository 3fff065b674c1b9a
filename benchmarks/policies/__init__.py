"""Policies that a benchmark scores; a folder of their own, since a policy imports from its own folder first."""
