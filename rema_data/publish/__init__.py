"""Folders that are ready to push to a repository of the Hugging Face Hub, or to any other host of files.

Read in this order: ``folder`` (a folder that appears whole, with its checksums), ``card`` (README.md of a release) and
``dataset`` (a release as such a folder). Networks are published by ``baselines.publish``.
"""

from __future__ import annotations

from rema_data.publish.dataset import publish_release
from rema_data.publish.folder import CHECKSUMS, Published, publication

__all__ = ["CHECKSUMS", "Published", "publication", "publish_release"]
