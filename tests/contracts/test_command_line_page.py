"""docs/command_line.md says what the commands say."""

from __future__ import annotations

from benchmarks.command_line import PAGE, page
from evaluator.cli.main import VERBS


def test_the_page_is_made_from_the_commands() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert text == page(), "python benchmarks/command_line.py writes it anew"
    assert [line.removeprefix("## rema ") for line in text.splitlines() if line.startswith("## ")] == list(VERBS)
