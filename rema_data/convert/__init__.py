"""Releases in other formats: out, and back with the same hashes.

Read in this order: ``base`` (what a format has to do), ``pieces`` (a block as a stream), ``layout`` (episodes as
robomimic lays them out), ``hdf5`` (that format, with its writer and reader), ``outbound`` and ``inbound`` (export and
import, whatever the format), ``formats`` (the formats that are installed). A further format is one module with a class
like ``Hdf5``, and an entry point.
"""

from __future__ import annotations

from rema_data.convert.base import ExportedFile, ExportOptions
from rema_data.convert.formats import find_format
from rema_data.convert.inbound import Imported, import_release
from rema_data.convert.outbound import export_release

__all__ = [
    "ExportOptions",
    "ExportedFile",
    "Imported",
    "export_release",
    "find_format",
    "import_release",
]
