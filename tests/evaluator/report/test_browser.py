"""The page in a real browser, where there is one: it paints, it is as wide as its window, and its pictures decode."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from evaluator.report import WrittenReport

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
WIDTHS = [1280, 390]
MEASURE = """<script>addEventListener("load", () => {
  const seen = [...document.images].filter((one) => one.complete && one.naturalWidth > 0).length;
  const buttons = document.querySelectorAll(".filter button");
  buttons[1].click();
  const shown = [...document.querySelectorAll("article")].filter((one) => one.offsetHeight > 0).length;
  const root = document.documentElement;
  parent.postMessage({window: innerWidth, page: root.scrollWidth, pictures: document.images.length, seen, shown}, "*");
})</script>"""
FRAME = """<!DOCTYPE html><title>nothing</title>
<script>addEventListener("message", (event) => { document.title = JSON.stringify(event.data); })</script>
<iframe src="measured.html" width="WIDTH" height="800"></iframe>"""

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed: apt-get install chromium")


def browse(folder: Path, page: Path, *options: str) -> str:
    """What a headless Chromium prints about a page."""
    command = [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'profile'}"]
    command += ["--disable-dev-shm-usage", "--hide-scrollbars", *options, page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("width", WIDTHS)
def test_the_page_is_painted(width: int, push_report: WrittenReport, tmp_path: Path) -> None:
    picture = tmp_path / "page.png"
    browse(tmp_path, push_report.path, f"--window-size={width},3000", f"--screenshot={picture}")
    with Image.open(picture) as image:
        assert image.width == width
        colours = image.convert("RGB").getcolors(1 << 24)
        pixels = np.asarray(image.convert("RGB"))
    assert colours is not None and len(colours) > 200
    painted = (pixels != pixels[0, 0]).any(axis=2)
    assert painted[:300].any() and painted[1500:].any()  # the headline, and what is far below it


@pytest.mark.parametrize("width", WIDTHS)
def test_the_page_is_no_wider_than_its_window(width: int, push_report: WrittenReport, tmp_path: Path) -> None:
    """In a frame: a window of its own is not made narrower than 500 pixels."""
    text = push_report.path.read_text(encoding="utf-8")
    text, count = re.subn(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", text)
    assert count == 1
    (tmp_path / "measured.html").write_text(text.replace("</body>", f"{MEASURE}</body>"), encoding="utf-8")
    frame = tmp_path / "frame.html"
    frame.write_text(FRAME.replace("WIDTH", str(width)), encoding="utf-8")
    found = re.search(r"<title>(.*?)</title>", browse(tmp_path, frame, "--virtual-time-budget=20000", "--dump-dom"))
    assert found is not None
    measured = json.loads(found.group(1))
    assert measured["window"] == width
    assert measured["page"] <= width
    assert measured["pictures"] == measured["seen"] > 0
    assert measured["shown"] == 1  # after a click on the first label


def test_the_policy_of_the_page_lets_only_its_own_script_run(push_report: WrittenReport, tmp_path: Path) -> None:
    text = push_report.path.read_text(encoding="utf-8")
    foreign = "<script>document.title = 'foreign';</script><img src='https://example.org/x.png'></body>"
    page = tmp_path / "page.html"
    page.write_text(text.replace("</body>", foreign), encoding="utf-8")
    dumped = browse(tmp_path, page, "--dump-dom")
    title = re.search(r"<title>(.*?)</title>", dumped)
    assert title is not None and title.group(1) != "foreign"
    assert '<div class="filter">' in dumped  # the page's own script ran: it shows the buttons
