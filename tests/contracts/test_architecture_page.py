"""The drawing of docs/architecture.md is that of the code."""

from __future__ import annotations

from benchmarks.rooms import PAGE, drawing, room_imports


def test_the_drawing_shows_the_imports_of_the_code() -> None:
    assert drawing(room_imports()) in PAGE.read_text(encoding="utf-8"), "run: python benchmarks/rooms.py"
