"""The page: its own script alone may run, what comes from files stays text, and a file has all that it shows."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from pathlib import Path
from typing import Any

import pytest

from evaluator.view import Viewer, open_source, write_page
from evaluator.view.page import served_page
from evaluator.view.static import spread
from rema_data.errors import InputError, IntegrityError
from tests.evaluator.report.conftest import HOSTILE_NAME


def parts(page: str) -> tuple[str, str, str, Any]:
    """Content security policy, style, script and data of a page."""
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page)
    style, data, script = (
        re.search(pattern, page, re.DOTALL)
        for pattern in (
            r"<style>(.*?)</style>",
            r'<script type="application/json" id="data">(.*?)</script>',
            r"<script>(.*?)</script>",
        )
    )
    assert policy and style and data and script
    return policy[1], style[1], script[1], json.loads(data[1])


def test_only_the_pages_own_style_and_script_are_allowed(viewer: Viewer) -> None:
    policy, style, script, data = parts(served_page(viewer).decode())
    assert policy.startswith("default-src 'none'; connect-src 'self'; img-src 'self' data:;")
    for text in (style, script):
        assert f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" in policy
    assert data == {"about": viewer.about(), "recorded": None}


def test_the_page_asks_no_other_machine(viewer: Viewer) -> None:
    _, style, script, _ = parts(served_page(viewer).decode())
    assert "http:" not in style + script and "https:" not in style + script and "url(" not in style
    assert "innerHTML" not in script and "insertAdjacentHTML" not in script and "eval(" not in script


def test_words_of_a_file_cannot_end_their_element(push_run: Path, tmp_path: Path) -> None:
    viewer = Viewer(open_source(str(push_run)))
    page = served_page(viewer).decode()
    assert HOSTILE_NAME in parts(page)[3]["about"]["name"]
    assert HOSTILE_NAME not in page and "<img src=x" not in page


def test_a_file_has_everything_that_it_shows(viewer: Viewer, tmp_path: Path) -> None:
    places = spread(list(range(72)), 9)
    written = write_page(viewer, places, tmp_path / "page.html")
    text = written.path.read_text(encoding="utf-8")
    assert (written.episodes, written.size) == (9, len(text.encode()))
    policy, _, _, data = parts(text)
    assert "connect-src" not in policy and "img-src data:;" in policy
    recorded = data["recorded"]
    assert recorded["rows"] == [viewer.source.table.row(place) for place in places]
    assert recorded["of"] == 72 and data["about"]["episodes"] == 9
    for row in recorded["rows"]:
        assert recorded["episodes"][row["id"]] == viewer.episode(row["id"])
        for step in recorded["episodes"][row["id"]]["steps"]:
            for what in ("scene", "ee1", "ee2"):
                picture = recorded["pictures"][f"{row['id']} {step['step']} {what}"]
                png = base64.b64decode(picture.removeprefix("data:image/png;base64,"))
                assert png == viewer.picture(row["id"], step["step"], what)
    again = write_page(viewer, places, tmp_path / "again.html")
    assert again.path.read_bytes() == written.path.read_bytes()


def test_a_file_can_have_steps_that_were_played_again(push_run: Path, tmp_path: Path) -> None:
    viewer = Viewer(open_source(str(push_run)))
    places = [0, 9]  # the second one has no answer of the policy
    page = write_page(viewer, places, tmp_path / "page.html", play=True).path.read_text(encoding="utf-8")
    plays = parts(page)[3]["recorded"]["plays"]
    for place, name in zip(places, (viewer.source.table.ids[place] for place in places), strict=True):
        assert (f"{name} 0" in plays) == (viewer.source.steps(place)[0].row["action"] is not None)
    assert {play["agreement"] for play in plays.values()} == {"identical"}


def test_a_file_of_damaged_maps_is_not_written(copied: Path, tmp_path: Path) -> None:
    (path,) = (path for path in (copied / "round-1/grasp/train/maps.zarr/scene/c").rglob("*") if path.is_file())
    path.write_bytes(bytes(path.stat().st_size))
    viewer = Viewer(open_source(str(copied)))
    with pytest.raises(IntegrityError, match="is damaged"):
        write_page(viewer, [0, 1], tmp_path / "page.html")
    assert not (tmp_path / "page.html").exists()


def test_a_file_of_nothing_and_of_another_kind_are_refused(viewer: Viewer, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no episode was selected"):
        write_page(viewer, [], tmp_path / "page.html")
    with pytest.raises(InputError, match="is not an HTML file"):
        write_page(viewer, [0], tmp_path / "page.png")


def test_chosen_rows_are_spread_evenly() -> None:
    assert spread(list(range(100)), 4) == [12, 37, 62, 87]
    assert spread([5, 7], 9) == [5, 7]
