"""``rema doctor``: what of this machine stands between a user and training.

``versions`` (packages), ``places`` (the home folder, releases), ``disposable`` (decoded caches, partial downloads),
``speed`` (a short reading test), and ``diagnosis``, which puts them together and says what to do.
"""

from __future__ import annotations

from rema_data.doctor.diagnosis import Diagnosis, diagnose
from rema_data.doctor.disposable import prune

__all__ = ["Diagnosis", "diagnose", "prune"]
