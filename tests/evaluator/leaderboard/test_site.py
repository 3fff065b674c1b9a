"""The board as pages: every policy has one, every link leads somewhere, and no name is markup."""

from __future__ import annotations

import errno
import html
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from click.testing import CliRunner

from evaluator.cli.main import VERBS, cli
from evaluator.leaderboard import site
from evaluator.leaderboard.site import write_site
from rema_data.errors import RunMismatchError, StorageError
from tests.evaluator.leaderboard.test_export import BOARD, HOSTILE


class Links(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.scripts = 0
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.scripts += tag == "script"
        self.found += [value or "" for name, value in attrs if name == "href"]


def test_every_policy_has_a_page_and_every_link_leads_somewhere(tmp_path: Path) -> None:
    assert write_site(BOARD, tmp_path / "site") == 5  # three policies, the board, the guide
    pages = sorted((tmp_path / "site").rglob("*.html"))
    assert len(pages) == 5
    for page in pages:
        links = Links(page.read_text())
        assert links.scripts == 0 and links.found
        for link in links.found:
            assert link.startswith("https://example.org/") or (page.parent / link).is_file(), link
    (mine,) = (tmp_path / "site" / "policies").glob("*-mine.html")
    text = mine.read_text()
    assert "grasp_push" in text and "missed" in text and "50.0" in text and "d" * 12 in text
    assert "https://example.org/?a=1&amp;b=2" in text
    assert "runs/mine" not in (tmp_path / "site" / "board.json").read_text()
    (paper,) = (tmp_path / "site" / "policies").glob("*-joint.html")
    assert "Table 2" in paper.read_text()
    assert any(html.escape(HOSTILE) in page.read_text() for page in pages)


def test_the_guide_names_verbs_that_exist(tmp_path: Path) -> None:
    write_site(BOARD, tmp_path / "site")
    named = set(re.findall(r"<code>rema (\w+)", (tmp_path / "site" / "submit.html").read_text()))
    assert named == {"check", "evaluate", "submit"} and named <= set(VERBS)


def test_nothing_is_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, data: str) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(site, "write_atomic", full)
        with pytest.raises(StorageError, match="no space is left"):
            write_site(BOARD, tmp_path / "out" / "site")
    assert not (tmp_path / "out").exists()
    write_site(BOARD, tmp_path / "out" / "site")
    with pytest.raises(RunMismatchError, match="choose another folder with --output"):
        write_site(BOARD, tmp_path / "out" / "site")


@pytest.mark.parametrize(
    "options", ["--export site", "--output new", "--export md --output new", "--json --output new"]
)
def test_a_site_needs_a_folder_and_a_folder_a_site(
    options: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(cli, ["leaderboard", *options.split()])
    assert result.exit_code == 2 and "--export site --output FOLDER" in result.stderr and not Path("new").exists()
