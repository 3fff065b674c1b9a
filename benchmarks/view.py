"""How long `rema view` takes: from the command to the first rows, from an address to a painted page, from key to map.

    python benchmarks/view.py                                   # rema-v1, 108,000 episodes; with Chromium also the page
    python benchmarks/view.py --pictures docs/images            # also the pictures of docs/view.md

A process of its own serves the release; the files are in the page cache. Requests are medians over episodes that are
spread over the release, so that no answer was kept.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import psutil
from PIL import Image
from rich.table import Table

from benchmarks.browser import CHROMIUM, Browser
from benchmarks.results import ROOT, finish, parser, target

FIRST_PAGE_S = 1.0
STEP_S = 0.25
"""From a key to the map of the next episode."""
LISTED = "document.querySelectorAll('.row').length > 5"
DRAWN = "document.images.length > 2 && [...document.images].every((one) => one.complete && one.naturalWidth)"
QUERIES: dict[str, dict[str, str]] = {
    "rows, unfiltered": {},
    "rows, two filters": {"split": "train", "outcome": "failed"},
    "rows, a search": {"q": "missed sim_steps>100"},
    "rows, sorted": {"sort": "-sim_steps"},
}
LINK = "task=grasp_push&failure=illegal_contact&round=4&episode=round-4/grasp_push/train/36"
PICTURES = {"view": (1280, 900, False), "view_phone": (390, 844, True)}
"""Pictures of the documentation: width and height in pixels, and whether the colours are dark."""

COLOURS = 256
"""Of a picture: enough for text and flat colours, and small enough for a repository."""


def serve(release: str) -> tuple[subprocess.Popen[str], str, tuple[float, float]]:
    """A process that serves a release, its address, and the seconds until its first rows: by the clock, of its own."""
    began = time.perf_counter()
    command = [sys.executable, "-m", "evaluator.cli", "view", release, "--no-browser"]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert process.stdout is not None
    address = process.stdout.readline().strip()
    if not address:
        raise SystemExit(f"{release} cannot be shown: rema view {release} says why")
    get(address, "api/rows")
    waited = time.perf_counter() - began
    times = psutil.Process(process.pid).cpu_times()
    return process, address, (waited, times.user + times.system)


def get(address: str, path: str, **parameters: Any) -> Any:
    """An answer of the server."""
    with urllib.request.urlopen(f"{address}{path}?{urlencode(parameters)}", timeout=300) as answer:
        body = answer.read()
    return json.loads(body) if path.startswith("api/") and "picture" not in path else body


def requests(address: str, repeats: int) -> dict[str, float]:
    """Median seconds of every kind of request."""
    total = get(address, "api/rows")["total"]
    places = [total * n // repeats for n in range(repeats)]
    ids = [get(address, "api/rows", offset=place, limit=1)["rows"][0]["id"] for place in places]
    # another word each time: no selection is asked for twice
    asked: dict[str, list[tuple[str, dict[str, Any]]]] = {
        name: [("api/rows", {**query, "q": f"{query.get('q', '')} steps!={90 + n}"}) for n in range(repeats)]
        for name, query in QUERIES.items()
    }
    asked["the page"] = [("", {})] * repeats
    asked["an episode"] = [("api/episode", {"episode": one}) for one in ids]
    asked["a map"] = [("api/picture", {"episode": one, "step": 0, "what": "scene"}) for one in ids]
    found: dict[str, float] = {}
    for name, calls in asked.items():
        times = []
        for path, parameters in calls:
            began = time.perf_counter()
            get(address, path, **parameters)
            times.append(time.perf_counter() - began)
        found[name] = statistics.median(times)
    return found


def pages(address: str, repeats: int) -> dict[str, float]:
    """Median seconds from an address to what is painted, and from a key to the next episode's maps."""
    with Browser() as browser:
        first = statistics.median(browser.open(address, LISTED) for _ in range(repeats))
        link = get(address, "api/rows", offset=get(address, "api/rows")["total"] // 2, limit=1)["rows"][0]["id"]
        linked = statistics.median(browser.open(f"{address}#{link}", f"{LISTED} && {DRAWN}") for _ in range(repeats))
        steps = []
        for _ in range(repeats):
            shown = browser.evaluate("document.querySelector('#shown h2').textContent")
            time.sleep(0.5)  # as somebody who looks: the next ones are asked for meanwhile
            began = time.perf_counter()
            browser.press("j")
            browser.wait(f"document.querySelector('#shown h2').textContent !== {json.dumps(shown)} && {DRAWN}")
            steps.append(time.perf_counter() - began)
    return {"first page": first, "a link to an episode": linked, "the next episode": statistics.median(steps)}


def draw(address: str, folder: Path, link: str) -> None:
    """The pictures of the documentation."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (width, height, dark) in PICTURES.items():
        with Browser(width, height, dark) as browser:
            browser.open(f"{address}#{link}", DRAWN)
            time.sleep(0.5)
            browser.screenshot(folder / f"{name}.png")
        with Image.open(folder / f"{name}.png") as picture:
            small = picture.convert("RGB").quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        small.save(folder / f"{name}.png", optimize=True)


def main() -> int:
    """Serve, ask, print."""
    arguments_ = parser(__doc__)
    arguments_.add_argument("--release", default="rema-v1", help="name or folder")
    arguments_.add_argument("--repeats", type=int, default=9, help="how often everything is asked for")
    arguments_.add_argument("--pictures", type=Path, metavar="FOLDER", help="write the pictures of docs/view.md")
    arguments_.add_argument("--link", default=LINK, help="what the pictures show, as in the page's address")
    arguments = arguments_.parse_args()
    colds = []
    for _ in range(3):
        process, address, cold = serve(arguments.release)
        colds.append(cold)
        if len(colds) < 3:
            stop(process)
    try:
        episodes = get(address, "api/rows")["total"]
        asked = requests(address, arguments.repeats)
        shown = {} if CHROMIUM is None else pages(address, arguments.repeats)
        if arguments.pictures is not None:
            draw(address, arguments.pictures, arguments.link)
    finally:
        stop(process)

    waited, computed = (statistics.median(times) for times in zip(*colds, strict=True))
    table = Table("what", "seconds", title=f"browsing {arguments.release}, {episodes:,} episodes: medians")
    table.add_row("from the command to the first rows", f"{waited:.2f}")
    table.add_row("of which processor time", f"{computed:.2f}")
    for name, value in shown.items():
        table.add_row(f"in Chromium: {name}", f"{value:.2f}")
    for name, value in asked.items():
        table.add_row(f"request: {name}", f"{value:.4f}")
    first = asked["the page"] + asked["rows, unfiltered"]
    targets = [target("page and first rows, answered", f"< {FIRST_PAGE_S:g} s", f"{first:.3f} s", first < FIRST_PAGE_S)]
    if shown:
        page, step = shown["first page"], shown["the next episode"]
        targets.append(target("first page, painted", f"< {FIRST_PAGE_S:g} s", f"{page:.2f} s", page < FIRST_PAGE_S))
        targets.append(target("from a key to the next maps", f"< {STEP_S:g} s", f"{step:.2f} s", step < STEP_S))
    notes = [] if shown else ["No Chromium is installed: the page was not opened."]
    numbers = {
        "episodes": episodes,
        "command_s": waited,
        "command_processor_s": computed,
        "requests_s": asked,
        "pages_s": shown,
    }
    return finish(arguments, "view", [table], targets, notes, numbers)


def stop(process: subprocess.Popen[str]) -> None:
    """End a server."""
    process.terminate()
    process.wait(60)
    assert process.stdout is not None
    process.stdout.close()


if __name__ == "__main__":
    sys.exit(main())
