"""The page in a real browser: it lists, filters, scrubs, follows links, says faults, and fits windows of two widths."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlencode

import pytest

from benchmarks.browser import CHROMIUM, Browser
from evaluator.view import Viewer, open_source, serving, write_page
from tests.evaluator.view.conftest import Client

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed: apt-get install chromium")

LISTED = "document.querySelectorAll('.row').length > 0"
DRAWN = "document.images.length > 2 && [...document.images].every((one) => one.complete && one.naturalWidth > 0)"
FAULT = "document.querySelector('.fault')"
IDS = "JSON.stringify([...document.querySelectorAll('.row .id')].map((one) => one.textContent))"
QUERIES = [
    {},
    {"task": "grasp_push", "failure": "missed"},
    {"q": "T sim_steps>50", "sort": "-sim_steps"},
    {"q": "ROUND-2/", "split": "val", "sort": "failure"},
    {"q": "7"},
    {"round": "2", "sort": "-id"},
    {"q": "lift_m<=0 failure!=missed", "sort": "target_shape"},
]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser() as made:
        yield made


@pytest.fixture(scope="module")
def file(viewer: Viewer, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A page of all episodes in one file."""
    path = tmp_path_factory.mktemp("file") / "page.html"
    return write_page(viewer, range(len(viewer.source.table)), path).path.as_uri()


@pytest.mark.parametrize("query", QUERIES, ids=urlencode)
def test_a_file_selects_what_the_server_selects(
    query: dict[str, str], browser: Browser, client: Client, viewer: Viewer, file: str
) -> None:
    expected = viewer.rows(urlencode(query))
    assert expected["rows"]
    for address in (client.address, file):
        browser.open(f"{address}#{urlencode(query)}", LISTED)
        shown = json.loads(browser.evaluate(IDS))
        assert shown and shown == [row["id"] for row in expected["rows"][: len(shown)]]
        count = browser.evaluate("document.getElementById('count').textContent")
        assert count.startswith(f"{expected['total']} episode")
        checked = "[...document.querySelectorAll('#groups input:checked')].map((one) => one.value).join()"
        assert browser.evaluate(checked) == ",".join(value for name, value in query.items() if name not in "q sort")
        found = json.loads(
            browser.evaluate(
                "JSON.stringify([...document.querySelectorAll('#groups input')].map((one) => "
                "[one.name, one.value, Number(one.parentElement.lastChild.textContent)]))"
            )
        )
        assert all(expected["counts"][name][value] == count for name, value, count in found) and found


def test_keys_go_through_the_episodes_and_their_steps(browser: Browser, client: Client, viewer: Viewer) -> None:
    rows = viewer.rows("task=grasp_grasp&sort=-steps")["rows"]
    browser.open(f"{client.address}#task=grasp_grasp&sort=-steps", LISTED)
    for row in (rows[0], rows[1]):
        browser.press("j")
        browser.wait(f"document.querySelector('#shown h2')?.textContent === '{row['id']}' && {DRAWN}")
        assert browser.evaluate("document.querySelector('.row[aria-current] .id').textContent") == row["id"]
    browser.press("k")
    browser.wait(f"document.querySelector('#shown h2')?.textContent === '{rows[0]['id']}' && {DRAWN}")
    assert rows[0]["steps"] == 3
    browser.press("ArrowLeft")
    browser.wait("document.querySelector('.steps [aria-pressed=true]').textContent.startsWith('2 grasp')")
    assert browser.evaluate("location.hash").endswith(f"&episode={rows[0]['id']}&step=1")
    browser.press("End")
    browser.wait(f"document.querySelector('#shown h2')?.textContent === '{rows[-1]['id']}'")
    browser.press("Escape")
    browser.wait("!location.hash.includes('episode')")


def test_a_link_opens_its_episode_in_the_list(browser: Browser, client: Client, viewer: Viewer, file: str) -> None:
    name = viewer.source.table.ids[-1]
    for address in (client.address, file):
        for link in (name, f"q=grasp&episode={name}"):
            browser.open(f"{address}#{link}", f"{DRAWN} && {LISTED}")
            assert browser.evaluate("document.querySelector('#shown h2').textContent") == name
            browser.wait("document.querySelector('.row[aria-current]')")
            assert browser.evaluate("document.getElementById('position').textContent").endswith("of 72")
            alts = browser.evaluate("[...document.images].every((one) => one.alt.includes('" + name + "'))")
            assert alts is True


@pytest.mark.parametrize(
    ("link", "sentence", "hint"),
    [
        ("round-9/grasp/train/0", "there is no episode 'round-9/grasp/train/0'", ""),
        ("episode=round-1/grasp/train/0&step=5", "has no step 5", "its steps are"),
        ("task=fly", "no episode has task fly", "there are: grasp"),
        ("q=width>1", "there is no column width", "the columns are"),
        ("q=lift_m>high", "'high' is not a number", "lift_m>0.05"),
    ],
)
def test_a_link_to_what_there_is_not_is_named(
    link: str, sentence: str, hint: str, browser: Browser, client: Client, file: str
) -> None:
    for address in (client.address, file):
        browser.open(f"{address}#{link}", FAULT)
        said = browser.evaluate(f"{FAULT}.textContent")
        assert sentence in said and hint in said


def test_damage_is_named_in_place_of_the_picture(browser: Browser, copied: Path) -> None:
    (path,) = (path for path in (copied / "round-1/grasp/train/maps.zarr/scene/c").rglob("*") if path.is_file())
    path.write_bytes(bytes(path.stat().st_size))
    with serving(Viewer(open_source(str(copied)))) as address:
        browser.open(f"{address}#round-1/grasp/train/0", FAULT)
        assert "rema verify" in browser.evaluate(f"{FAULT}.textContent")


@pytest.mark.parametrize("width", [1280, 820, 390])
def test_nothing_is_wider_than_the_window(width: int, browser: Browser, client: Client, viewer: Viewer) -> None:
    name = viewer.rows("task=grasp_grasp&sort=-steps")["rows"][0]["id"]
    browser.resize(width, 900)
    try:
        for link in ("", f"#{name}"):
            browser.open(client.address + link, DRAWN if link else LISTED)
            assert browser.evaluate("document.documentElement.scrollWidth") <= width
            every = "[...document.querySelectorAll('#episode, #list, #filters')]"
            visible = f"{every}.filter((one) => one.offsetHeight > 0)"
            assert browser.evaluate(f"{visible}.every((one) => one.scrollWidth <= one.clientWidth + 1)") is True
            assert browser.evaluate(f"{visible}.length") == (3 if width > 720 else 1 if link else 2)
    finally:
        browser.resize(1280, 900)


# relative luminance of the colour of an element and of what is behind it (WCAG 2)
CONTRASTS = """
(() => {
  const light = (colour) => colour.match(/[0-9.]+/g).slice(0, 3).map(Number)
    .map((one) => one / 255).map((one) => one <= 0.04045 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4)
    .reduce((sum, one, at) => sum + one * [0.2126, 0.7152, 0.0722][at], 0);
  const behind = (one) => {
    for (; one; one = one.parentElement) {
      const colour = getComputedStyle(one).backgroundColor;
      if (!/, 0\\)|transparent|color\\(/.test(colour)) return colour;
    }
    return "rgb(255, 255, 255)";
  };
  return Math.min(...[...document.querySelectorAll("body *:not(script)")]
    .filter((one) => one.offsetHeight && !one.disabled)
    .filter((one) => [...one.childNodes].some((node) => node.nodeType === Node.TEXT_NODE && node.data.trim()))
    .map((one) => [light(getComputedStyle(one).color), light(behind(one))])
    .map(([a, b]) => (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05)));
})()
"""


@pytest.mark.parametrize("dark", [False, True])
def test_every_text_can_be_read(dark: bool, browser: Browser, client: Client, viewer: Viewer) -> None:
    name = viewer.rows("failure=missed")["rows"][0]["id"]
    browser.resize(1280, 900, dark)
    try:
        for link in (name, "nobody"):
            browser.open(f"{client.address}#{link}", f"{LISTED} && ({DRAWN} || {FAULT})")
            assert browser.evaluate(CONTRASTS) >= 4.5
    finally:
        browser.resize(1280, 900)


def test_a_step_is_played_again_at_a_key(browser: Browser, push_run: Path) -> None:
    viewer = Viewer(open_source(str(push_run)))
    name = viewer.rows("outcome=success")["rows"][0]["id"]
    with serving(viewer) as address:
        browser.open(f"{address}#{name}", DRAWN)
        assert browser.evaluate("document.querySelector('h1').textContent") == viewer.source.name  # as text
        browser.press("f")
        browser.wait("document.querySelectorAll('.played img').length === 3")
        assert "to the last digit" in browser.evaluate("document.querySelector('.play').textContent")
