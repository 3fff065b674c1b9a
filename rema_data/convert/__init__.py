"""Releases in other formats: out, and back with the same hashes.

Read in this order: ``base`` (what a format has to do), ``pieces`` (a block as a stream), ``layout`` (episodes as
arrays), ``hdf5`` (robomimic's files, with their writer and reader), ``seal`` and ``folders`` (what the formats of
folders share), ``lerobot``, ``minari``, ``rlds`` and ``huggingface`` (these formats), ``outbound`` and ``inbound``
(export and import, whatever the format), ``formats`` (the formats that are installed). A further format is a class like
``Rlds``, and an entry point.
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
