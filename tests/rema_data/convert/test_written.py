"""Files are read back before they have their names, and a signal inside HDF5 reaches Python between two steps only."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import pytest

from rema_data.convert import export_release, hdf5_file, import_release
from rema_data.errors import StorageError
from rema_data.loader.build import _FileSink, open_cache
from rema_data.release.folder import ReleaseFolder
from rema_data.store.maps import _Buffered
from tests.rema_data.convert.conftest import files


def bend(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    """Change a byte of the n-th large write of an export, as if it had been lost."""
    write, seen = hdf5_file._Sink.write, [0]

    def bent(self: Any, data: Any) -> int:
        view = bytearray(data)
        if len(view) > 200:
            seen[0] += 1
            if seen[0] == number:
                view[len(view) // 2] ^= 0x55
        return write(self, bytes(view))

    monkeypatch.setattr(hdf5_file._Sink, "write", bent)


@pytest.mark.parametrize("number", [1, 9, 40])
def test_an_export_that_was_not_written_as_meant_has_no_name(
    number: int, release: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bend(monkeypatch, number)
    with pytest.raises(StorageError, match=r"grasp\.hdf5 was not written"):
        export_release(release, tmp_path, tasks=["grasp"])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", [1, 30])
def test_ctrl_c_inside_hdf5(
    number: int, release: ReleaseFolder, exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a user of the library presses it: a KeyboardInterrupt, no half file, and the right bytes after it."""
    write, seen = hdf5_file._Sink.write, [0]

    def interrupted(self: Any, data: Any) -> int:
        seen[0] += 1
        if seen[0] == number:
            os.kill(os.getpid(), signal.SIGINT)
        return write(self, data)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with monkeypatch.context() as patch:
            patch.setattr(hdf5_file._Sink, "write", interrupted)
            with pytest.raises(KeyboardInterrupt):
                export_release(release, tmp_path, tasks=["grasp"])
    finally:
        signal.signal(signal.SIGINT, before)
    assert list(tmp_path.iterdir()) == []
    export_release(release, tmp_path, tasks=["grasp"])
    assert files(tmp_path).items() <= files(exported).items()


def test_maps_of_an_import_are_read_back(exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flush = _Buffered.flush

    def bent(self: Any) -> None:
        if self._count:
            flush(self)
            self._array[0] = self._array[0] + 1

    monkeypatch.setattr(_Buffered, "flush", bent)
    with pytest.raises(StorageError, match=r"maps\.zarr/scene was not written"):
        import_release([exported / "grasp.hdf5"], tmp_path / "back", "part")
    assert not (tmp_path / "back").exists()


def test_a_decoded_cache_is_read_back(release: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put = _FileSink.put

    def bent(self: Any, name: str, start: int, rows: Any) -> None:
        put(self, name, start, rows)
        if name == "scene":
            with (self._folder / "scene.npy").open("rb+") as file:
                file.seek(-2, os.SEEK_END)
                file.write(b"??")

    monkeypatch.setattr(_FileSink, "put", bent)
    with pytest.raises(StorageError, match=r"scene\.npy was not written"):
        open_cache(release, release.blocks(), tmp_path)
    assert [path.suffix for path in tmp_path.iterdir()] in ([], [".lock"])
