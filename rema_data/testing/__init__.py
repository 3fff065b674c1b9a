"""Helpers for tests of code that reads releases, and the conformance kit for code that extends rema_data.

``make_release`` and its parts make small synthetic releases without a simulator. ``rema_data.testing.formats`` has the
tests that every export format must pass; it needs pytest.
"""

from rema_data.testing.releases import FINGERPRINT, make_block, make_release, synthetic_episode

__all__ = ["FINGERPRINT", "make_block", "make_release", "synthetic_episode"]
