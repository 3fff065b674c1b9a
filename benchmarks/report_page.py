"""Writing the page of a run, and opening it: seconds, megabytes, and whether it is as wide as its window.

    python benchmarks/report_page.py                                    # makes a run of 10,000 episodes first
    python benchmarks/report_page.py --run runs/random-grasp-conditional

The page is opened in a headless Chromium in a frame as wide as a desktop and as a phone; ``loaded`` is the time from
the start of the navigation to the load event, and ``closed`` the life of the whole browser, its own start included.
"""

from __future__ import annotations

import json
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.table import Table

from benchmarks.results import finish, parser, target
from evaluator.policy.loading import resolve
from evaluator.report import ReportOptions, write_report
from evaluator.runner import EvaluationConfig, run_evaluation
from rema_data.schema import TASKS

OPEN_S = 3.0
PAGE_MB = 15.0
WIDTHS = {"desktop": 1280, "phone": 390}
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
MEASURE = """<script>addEventListener("load", () => parent.postMessage(
  {loaded: performance.now() / 1000, window: innerWidth, page: document.documentElement.scrollWidth}, "*"))</script>"""
FRAME = """<!DOCTYPE html><title>nothing</title>
<script>addEventListener("message", (event) => { document.title = JSON.stringify(event.data); })</script>
<iframe src="measured.html" width="WIDTH" height="900"></iframe>"""


def make_run(folder: Path, policy: str, task: str, episodes: int) -> Path:
    """A run to write a page about."""
    config = EvaluationConfig(resolve(policy), task, folder, episodes=episodes)
    return run_evaluation(config).folder


def open_page(browser: str, page: Path, width: int) -> dict[str, Any]:
    """What the page says of itself in a frame of ``width`` pixels, and seconds until the browser was gone."""
    with tempfile.TemporaryDirectory(prefix="rema-page-") as name:
        folder = Path(name)
        text = page.read_text(encoding="utf-8")
        text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", text)  # it lets no other script run
        (folder / "measured.html").write_text(text.replace("</body>", f"{MEASURE}</body>"), encoding="utf-8")
        frame = folder / "frame.html"
        frame.write_text(FRAME.replace("WIDTH", str(width)), encoding="utf-8")
        command = [browser, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]
        command += [f"--user-data-dir={folder / 'profile'}", "--timeout=20000", "--dump-dom", frame.as_uri()]
        began = time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
        closed = time.perf_counter() - began
    found = re.search(r"<title>(\{.*?\})</title>", done.stdout)
    if found is None:
        raise SystemExit(f"{browser} did not load {page}")
    return {**json.loads(found.group(1)), "closed": closed}


def main() -> int:
    """Write, open, print."""
    arguments_ = parser(__doc__)
    arguments_.add_argument("--run", type=Path, help="run folder, instead of a new one")
    arguments_.add_argument("--policy", default="random", help="of a new run")
    arguments_.add_argument("--task", default="grasp_push", choices=list(TASKS), help="of a new run")
    arguments_.add_argument("--episodes", type=int, default=10_000, help="of a new run")
    arguments_.add_argument("--per-label", type=int, default=ReportOptions().per_label, help="episodes shown of each")
    arguments_.add_argument("--repeats", type=int, default=5, help="how often the page is opened")
    arguments = arguments_.parse_args()
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    with tempfile.TemporaryDirectory(prefix="rema-run-") as name:
        folder = Path(name)
        run = arguments.run or make_run(folder / "run", arguments.policy, arguments.task, arguments.episodes)
        summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
        began = time.perf_counter()
        written = write_report(run, folder / "page.html", ReportOptions(per_label=arguments.per_label))
        writing_s = time.perf_counter() - began
        began = time.perf_counter()
        bare = write_report(run, folder / "bare.html", ReportOptions(per_label=0))
        bare_s = time.perf_counter() - began
        opened = {
            kind: [open_page(browser, written.path, width) for _ in range(arguments.repeats)]
            for kind, width in WIDTHS.items()
            if browser is not None
        }

    what = f"{summary['policy']} on {summary['task']}, {summary['episodes']:,} episodes"
    pages = Table("page", "MB", "episodes shown", "seconds to write", title=f"the report of {what}")
    pages.add_row("with pictures", f"{written.size / 1e6:.2f}", str(written.shown), f"{writing_s:.1f}")
    pages.add_row("without", f"{bare.size / 1e6:.2f}", "0", f"{bare_s:.1f}")
    tables = [pages]
    targets = [
        target("size of the page", f"< {PAGE_MB:g} MB", f"{written.size / 1e6:.1f} MB", written.size < PAGE_MB * 1e6)
    ]
    numbers: dict[str, Any] = {
        "run": what,
        "bytes": written.size,
        "bare_bytes": bare.size,
        "shown": written.shown,
        "pictures_left_out": written.left_out,
        "played_again": dict(written.agreement),
        "writing_s": writing_s,
        "bare_writing_s": bare_s,
    }
    notes = ["Pictures are rendered in software, which takes most of the time to write."]
    if browser is None:
        notes.append("No Chromium is installed: the page was not opened.")
    else:
        views = Table("window", "pixels", "page, pixels", "loaded, s", "closed, s", title="opening the page, medians")
        for kind, times in opened.items():
            loaded, closed = (statistics.median(one[name] for one in times) for name in ("loaded", "closed"))
            wide = max(one["page"] for one in times)
            views.add_row(kind, str(WIDTHS[kind]), str(wide), f"{loaded:.2f}", f"{closed:.2f}")
            numbers[kind] = {"loaded_s": loaded, "closed_s": closed, "page_pixels": wide}
            targets.append(target(f"opening, {kind}", f"< {OPEN_S:g} s", f"{loaded:.2f} s", loaded < OPEN_S))
            narrow = wide <= WIDTHS[kind]
            targets.append(target(f"width, {kind}", f"<= {WIDTHS[kind]} pixels", f"{wide} pixels", narrow))
        tables.append(views)
    return finish(arguments, "report_page", tables, targets, notes, numbers)


if __name__ == "__main__":
    sys.exit(main())
