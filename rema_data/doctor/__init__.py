"""``rema doctor``: diagnose this machine (versions, home folder, releases, caches, reading speed).

``machine`` (versions, home folder, speed), ``releases``, ``disposable`` (decoded caches, partial downloads), and
``diagnosis``, which collects them with problems and advice.
"""

from __future__ import annotations

from rema_data.doctor.diagnosis import Diagnosis, diagnose
from rema_data.doctor.disposable import prune

__all__ = ["Diagnosis", "diagnose", "prune"]
