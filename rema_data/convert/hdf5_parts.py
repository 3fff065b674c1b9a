"""Parts of an HDF5 file that somebody else may have written: nothing outside of the file, and nothing that explodes.

HDF5 can place an array into any other file (links, external storage, virtual datasets), and a few stored bytes can
stand for any number of them. Every part is looked at before it is read.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from rema_data.convert.hdf5_file import damaged
from rema_data.errors import IntegrityError

__all__ = ["attributes", "dataset", "has", "members", "part", "values"]

_ANYWAY_BYTES = 64 << 20
"""What an array, or one of its chunks, may take in memory however little is stored of it."""
_MOST_PACKED = 1100
"""How many bytes one stored byte may stand for: gzip reaches 1,032."""
_MOST_ATTRIBUTE_BYTES = 1 << 16

Array = npt.NDArray[Any]


def _refusal(parent: h5py.Group, path: str, why: str) -> IntegrityError:
    return damaged(Path(parent.file.filename), f"{parent.name.rstrip('/')}/{path} {why}")


def has(parent: h5py.Group, path: str) -> bool:
    """Whether there is a part of that name; raises as ``part``."""
    try:
        part(parent, path)
    except KeyError:
        return False
    return True


def part(parent: h5py.Group, path: str) -> Any:
    """A group or an array of the file itself.

    Raises KeyError where there is none, IntegrityError where a link leads elsewhere.
    """
    found = parent.id  # below h5py, which needs longer for a link than for a small array
    for name in map(str.encode, path.split("/")):
        if not isinstance(found, h5py.h5g.GroupID) or not found.links.exists(name):
            raise KeyError(f"{parent.name.rstrip('/')}/{path}")
        if found.links.get_info(name).type != h5py.h5l.TYPE_HARD:
            link = h5py.Group(found).get(name, getlink=True)
            target = f"the file {link.filename!r}" if isinstance(link, h5py.ExternalLink) else f"{link.path!r}"
            raise _refusal(parent, path, f"is a link to {target}: an import follows none")
        found = h5py.h5o.open(found, name)
    return h5py.Group(found) if isinstance(found, h5py.h5g.GroupID) else h5py.Dataset(found)


def members(parent: h5py.Group) -> Iterator[tuple[str, Any]]:
    """Names and parts of a group, as ``part`` gives them."""
    for name in parent:
        yield name, part(parent, name)


def attributes(group: h5py.Group) -> dict[str, Any]:
    """The attributes of a group; raises IntegrityError where one is too large to be one of ours."""
    for name in group.attrs:
        found = group.attrs.get_id(name)
        if found.get_storage_size() > _MOST_ATTRIBUTE_BYTES:
            raise _refusal(group, name, f"is an attribute of {found.get_storage_size():,} bytes")
    return dict(group.attrs)


def dataset(parent: h5py.Group, path: str) -> h5py.Dataset:
    """An array that can be read: its content lies in the file, and is not much larger in memory.

    Raises KeyError or IntegrityError.
    """
    found = part(parent, path)
    if not isinstance(found, h5py.Dataset) or found.shape is None:
        raise _refusal(parent, path, "is not an array")
    properties = found.id.get_create_plist()
    if properties.get_external_count():
        file = properties.get_external(0)[0].decode(errors="replace")
        raise _refusal(parent, path, f"keeps its content in the file {file!r}: an import reads no other file")
    if properties.get_layout() == h5py.h5d.VIRTUAL:
        raise _refusal(parent, path, "is a virtual dataset, made of other files: an import reads no other file")
    if found.dtype.hasobject:
        raise _refusal(parent, path, "holds values of variable length")
    room = _ANYWAY_BYTES + _MOST_PACKED * found.id.get_storage_size()
    for what, shape in (("is", found.shape), ("has chunks of", found.chunks or ())):
        size = math.prod(map(int, shape)) * found.dtype.itemsize
        if size > room:
            raise _refusal(parent, path, f"{what} {size:,} bytes in memory, more than its file can hold")
    return found


def values(parent: h5py.Group, path: str) -> Array:
    """All values of an array; raises as ``dataset``."""
    return np.asarray(dataset(parent, path)[()])
