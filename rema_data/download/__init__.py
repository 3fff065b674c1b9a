"""Getting a release onto this machine: parallel, verified, resumed at the byte, from the first mirror that delivers.

::

    report = rema_data.download.download("rema-mini", tasks=["grasp"])
    release = rema_data.load("rema-mini")

Read in this order: ``fetch`` (the call), ``plan`` (what is here, what is missing), ``pool`` (threads), ``transfer``
(one file, until it is whole, and which sources are still asked), ``sources`` (where a file comes from), ``web`` (HTTP)
and ``part`` (the bytes that have arrived).
"""

from __future__ import annotations

from rema_data.download.fetch import download
from rema_data.download.plan import BlockPlan, DownloadReport

__all__ = ["BlockPlan", "DownloadReport", "download"]
