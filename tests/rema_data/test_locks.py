"""One process holds a lock; others wait or are told, and a file system without locks is named."""

from __future__ import annotations

import errno
import fcntl
import os
import signal
from pathlib import Path
from typing import Any

import pytest

from rema_data import interrupts
from rema_data.download import download
from rema_data.errors import StorageError
from rema_data.loader.build import open_cache
from rema_data.locks import Busy, lock
from rema_data.release.folder import find_release


def test_held_by_another(tmp_path: Path) -> None:
    path, told = tmp_path / "lock", []
    with lock(path):
        with pytest.raises(Busy), lock(path):
            pass

        def stop() -> None:
            told.append("waiting")
            os.kill(os.getpid(), signal.SIGINT)

        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            with interrupts.listening(), pytest.raises(interrupts.Interrupted), lock(path, wait=True, waiting=stop):
                pass
        finally:
            signal.signal(signal.SIGINT, before)
    assert told == ["waiting"]
    with lock(path):
        pass


@pytest.mark.parametrize("number", [errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_is_named_with_the_way_out(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*arguments: Any) -> None:
        raise OSError(number, "no locks here")

    monkeypatch.setenv("REMA_HOME", str(tmp_path))
    monkeypatch.setattr(fcntl, "flock", refuse)
    release = find_release("rema-sample")
    with (
        pytest.raises(StorageError, match=f"the file system of {tmp_path} has no file locks") as caught,
        lock(tmp_path / "lock"),
    ):
        pass
    assert "local disk" in caught.value.hint
    for work in (lambda: download("rema-sample"), lambda: open_cache(release, release.blocks())):
        with pytest.raises(StorageError, match="has no file locks") as caught:
            work()
        assert "REMA_HOME" in caught.value.hint
