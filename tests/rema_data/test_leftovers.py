"""What a killed process leaves is removed by the next one; what a live process holds is not."""

from __future__ import annotations

import errno
import fcntl
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from rema_data.leftovers import remove_abandoned, temporary_file, temporary_folder
from rema_data.storage import write_atomic

HOLD = """
import sys
from pathlib import Path
from rema_data.leftovers import temporary_file, temporary_folder
folder = Path(sys.argv[1])
with temporary_file(folder / "result.json"), temporary_folder(".made-", folder) as made:
    (made / "part").touch()
    print("ready", flush=True)
    sys.stdin.read()
"""


def holder(folder: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    return process


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_only_what_belongs_to_nobody_is_removed(tmp_path: Path) -> None:
    user_files = [".result.json.notes", ".made-by-me", ".result.json.12345678.bak"]
    for name in user_files:
        (tmp_path / name).touch()
    with holder(tmp_path) as process:
        held = names(tmp_path)
        assert len(held) == 2 + len(user_files)
        write_atomic(tmp_path / "result.json", "text")
        with temporary_folder(".made-", tmp_path):
            pass
        assert names(tmp_path) == sorted([*held, "result.json"])
        process.kill()
    assert names(tmp_path) == sorted([*held, "result.json"])
    write_atomic(tmp_path / "result.json", "text")
    with temporary_folder(".made-", tmp_path):
        pass
    assert names(tmp_path) == sorted([*user_files, "result.json"])


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS])
def test_without_locks_it_is_written_and_nothing_is_removed(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*arguments: Any) -> None:
        raise OSError(number, "no locks here")

    (tmp_path / ".result.json.12345678").touch()
    monkeypatch.setattr(fcntl, "flock", refuse)
    write_atomic(tmp_path / "result.json", "text")
    with temporary_folder(".result.json.", tmp_path) as folder:
        assert folder.is_dir()
    assert names(tmp_path) == [".result.json.12345678", "result.json"]


def test_a_folder_that_was_made_for_it_is_removed_where_nothing_else_is_in_it(tmp_path: Path) -> None:
    for kept in (False, True):
        with temporary_folder(".some-", tmp_path / "new" / "place") as folder:
            assert folder.parent == tmp_path / "new" / "place"
            if kept:
                (folder.parent / "result").write_text("")
        assert (tmp_path / "new" / "place" / "result").exists() == (tmp_path / "new").exists() == kept


def test_a_link_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    (tmp_path / ".made-12345678").symlink_to(tmp_path / "kept")
    remove_abandoned(tmp_path, ".made-")
    assert names(tmp_path) == [".made-12345678", "kept"]


def test_a_lock_that_cannot_be_opened_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No descriptor is left for it: nothing is tried again, and nothing is left behind."""
    opened = os.open

    def refuse(path: Any, flags: int, *more: Any, **options: Any) -> int:
        if not flags & os.O_CREAT:
            raise OSError(errno.EMFILE, "Too many open files")
        return opened(path, flags, *more, **options)

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", refuse)
        with pytest.raises(OSError, match="Too many"), temporary_folder(".made-", tmp_path):
            pass
        with pytest.raises(OSError, match="Too many"), temporary_file(tmp_path / "result.json"):
            pass
    assert names(tmp_path) == []
