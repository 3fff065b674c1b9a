"""Writes the parts of a new HDF5 file, and compares them with what can be read from it before it gets its name.

HDF5 is called below h5py, which needs longer for the names of an episode than for its maps. No part carries a time:
equal exports are equal bytes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import numpy.typing as npt
from h5py import h5a, h5d, h5g, h5i, h5o, h5p, h5s, h5t

from rema_data.interrupts import check
from rema_data.progress import Progress

__all__ = ["MapForm", "Written"]

Array = npt.NDArray[Any]
_TEXT = h5py.string_dtype()
_CHUNK, _LEVEL = 1 << 15, 4
"""Most values of a compressed array in a chunk, and gzip's level for them."""


class MapForm(NamedTuple):
    """How maps are stored: shape and type of one of them, and the level of gzip with which each was compressed."""

    shape: tuple[int, ...]
    dtype: str
    level: int


class _Noted(NamedTuple):
    """An array or an attribute as it was written. Checksums of HDF5 cover what it says of types and shapes."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    digest: bytes


class Written:
    """The parts of a file, with a digest of each as it was written."""

    def __init__(self, root: h5py.File) -> None:
        self.root: h5g.GroupID = h5g.open(root.id, b"/")
        self._arrays: dict[bytes, _Noted] = {}
        self._maps: dict[bytes, list[bytes]] = {}
        self._attributes: dict[bytes, dict[bytes, _Noted]] = {}
        # What HDF5 needs to know of a part takes longer to make than a small part itself.
        self._kinds: dict[tuple[np.dtype[Any], bool], h5t.TypeID] = {}
        self._spaces: dict[tuple[int, ...], h5s.SpaceID] = {}
        self._forms: dict[MapForm | None, h5p.PropDCID] = {}

    def __len__(self) -> int:
        return len(self._arrays) + len(self._maps) + len(self._attributes)

    def group(self, parent: h5g.GroupID, path: str, compact_attributes: int = 8) -> h5g.GroupID:
        """A group of that path, and those on the way to it, made where they are missing.

        One with more attributes than ``compact_attributes`` keeps them in a heap of its own, of some 1.4 kB.
        """
        for name in map(str.encode, path.split("/")):
            if name in parent:
                parent = h5g.open(parent, name)
                continue
            properties = h5p.create(h5p.GROUP_CREATE)
            properties.set_obj_track_times(False)
            properties.set_attr_phase_change(compact_attributes, compact_attributes * 3 // 4)
            parent = h5g.create(parent, name, gcpl=properties)
        return parent

    def array(self, parent: h5g.GroupID, name: str, array: Array, *, packed: bool = False) -> h5d.DatasetID:
        """An array; ``packed`` compresses one that is not empty."""
        array = np.ascontiguousarray(array)
        form = self._packed(array.shape) if packed and array.size else self._form(None)
        stored = self._kind(array.dtype, stored=True)
        made = h5d.create(parent, name.encode(), stored, self._space(array.shape), dcpl=form)
        made.write(h5s.ALL, h5s.ALL, array, mtype=self._kind(array.dtype))
        self._arrays[h5i.get_name(made)] = _Noted(array.dtype, array.shape, _digest(array))
        return made

    def maps(self, parent: h5g.GroupID, name: str, maps: Sequence[bytes], form: MapForm) -> None:
        """Maps, each in a chunk of its own, that are compressed already: one that occurs twice is compressed once."""
        kind, space = self._kind(np.dtype(form.dtype), stored=True), self._space((len(maps), *form.shape))
        made = h5d.create(parent, name.encode(), kind, space, dcpl=self._form(form))
        for number, data in enumerate(maps):
            made.write_direct_chunk((number, *(0 for _ in form.shape)), data)
        self._maps[h5i.get_name(made)] = [hashlib.sha256(data).digest() for data in maps]

    def attributes(self, part: h5g.GroupID | h5d.DatasetID, values: Mapping[str, Any]) -> None:
        """Attributes of a group or an array: texts and numbers."""
        noted = self._attributes.setdefault(h5i.get_name(part), {})
        for name, fact in values.items():
            value = np.array(fact, _TEXT if isinstance(fact, str) else None)
            made = h5a.create(part, name.encode(), self._kind(value.dtype, stored=True), self._space(()))
            made.write(value, mtype=self._kind(value.dtype))
            noted[name.encode()] = _Noted(value.dtype, (), _digest(value))

    def differs(self, path: Path, progress: Progress) -> str | None:
        """The first part of the closed file that is not as it was written; None where all of it is."""

        def step() -> None:
            check()
            progress.advance(1)

        try:
            with h5py.File(path, "r", locking=False) as file:
                for name, array in self._arrays.items():
                    step()
                    values, kind = np.empty(array.shape, array.dtype), self._kind(array.dtype)
                    h5d.open(file.id, name).read(self._space(array.shape), h5s.ALL, values, mtype=kind)
                    if _digest(values) != array.digest:
                        return name.decode()
                for name, digests in self._maps.items():
                    step()
                    if _chunks(h5d.open(file.id, name)) != digests:
                        return name.decode()
                for name, wanted in self._attributes.items():
                    step()
                    part = h5o.open(file.id, name)
                    for key, attribute in wanted.items():
                        value = np.empty((), attribute.dtype)
                        h5a.open(part, key).read(value, mtype=self._kind(attribute.dtype))
                        if _digest(value) != attribute.digest:
                            return f"the attributes of {name.decode()}"
        except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
            return str(error)
        return None

    def _kind(self, dtype: np.dtype[Any], *, stored: bool = False) -> h5t.TypeID:
        """The type in memory, where a text is a Python object, or as it is stored."""
        if (dtype, stored) not in self._kinds:
            self._kinds[dtype, stored] = h5t.py_create(dtype, logical=stored)
        return self._kinds[dtype, stored]

    def _space(self, shape: tuple[int, ...]) -> h5s.SpaceID:
        if shape not in self._spaces:
            self._spaces[shape] = h5s.create_simple(shape) if shape else h5s.create(h5s.SCALAR)
        return self._spaces[shape]

    def _form(self, form: MapForm | None) -> h5p.PropDCID:
        """How an array is stored: as it is, or a map a chunk."""
        if form not in self._forms:
            properties = h5p.create(h5p.DATASET_CREATE)
            properties.set_obj_track_times(False)
            if form is not None:
                properties.set_chunk((1, *form.shape))
                properties.set_deflate(form.level)
            self._forms[form] = properties
        return self._forms[form]

    @staticmethod
    def _packed(shape: tuple[int, ...]) -> h5p.PropDCID:
        properties = h5p.create(h5p.DATASET_CREATE)
        properties.set_obj_track_times(False)
        properties.set_chunk(tuple(min(size, _CHUNK) for size in shape))
        properties.set_shuffle()
        properties.set_deflate(_LEVEL)
        return properties


def _chunks(maps: h5d.DatasetID) -> list[bytes]:
    origin = (0,) * (maps.rank - 1)
    stored = (maps.read_direct_chunk((number, *origin)) for number in range(maps.shape[0]))
    return [hashlib.sha256(data).digest() if not skipped else b"" for skipped, data in stored]


def _digest(value: Array) -> bytes:
    if value.dtype.hasobject:  # text; HDF5 reads it as bytes
        text = value.item()
        return hashlib.sha256(text.encode() if isinstance(text, str) else text).digest()
    return hashlib.sha256(value.tobytes()).digest()
