"""``rema verify``: every byte and every invariant of a release.

Read in this order: ``findings`` (what is reported), ``check`` (the order of the checks), ``files`` (bytes, and
fetching them again), ``maps``, ``tables`` and ``variations`` (one block), ``leakage`` (across blocks and against the
frozen scenarios).
"""

from __future__ import annotations

from rema_data.verify.check import verify
from rema_data.verify.findings import Finding, Report

__all__ = ["Finding", "Report", "verify"]
