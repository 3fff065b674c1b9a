"""What was put into an HDF5 file, to be compared with what can be read from it before it gets its name."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from rema_data.interrupts import check

__all__ = ["Written"]


class Written:
    """Digests of all arrays and attributes of a file, noted as they are written."""

    def __init__(self) -> None:
        self._arrays: dict[str, bytes] = {}
        self._attributes: dict[str, dict[str, bytes]] = {}

    def array(self, name: str, array: npt.NDArray[Any]) -> None:
        """Note an array by its path in the file."""
        self._arrays[name] = _digest(array)

    def attributes(self, name: str, values: Mapping[str, Any]) -> None:
        """Note attributes of a group or an array."""
        self._attributes.setdefault(name, {}).update({key: _digest(value) for key, value in values.items()})

    def differs(self, path: Path) -> str | None:
        """The first part of a closed file that is not as it was written; None where all of it is."""
        try:
            with h5py.File(path, "r", locking=False) as root:
                for name, digest in self._arrays.items():
                    check()
                    if _digest(_stored(root, name)) != digest:
                        return name
                for name, wanted in self._attributes.items():
                    check()
                    if {key: _digest(value) for key, value in root[name].attrs.items()} != wanted:
                        return f"the attributes of {name}"
        except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
            return str(error)
        return None


def _stored(root: h5py.File, name: str) -> npt.NDArray[Any]:
    """An array of a file, without the steps of ``root[name][()]``, which take longer than a small array itself."""
    found = h5py.h5d.open(root.id, name.encode())
    array = np.empty(found.shape, found.dtype)
    found.read(h5py.h5s.ALL, h5py.h5s.ALL, array)
    return array


def _digest(value: Any) -> bytes:
    array = np.asarray(value)
    about = f"{array.dtype.str} {array.shape}".encode()
    return hashlib.sha256(about + np.ascontiguousarray(array).tobytes()).digest()
