"""``rema view``: every episode of a release or of a run, in a page."""

from __future__ import annotations

import time
import webbrowser
from contextlib import suppress
from urllib.parse import quote, urlencode

import click

from evaluator.cli.output import line, note
from rema_data import interrupts

__all__ = ["view"]


@click.command()
@click.argument("release_or_run", required=False)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Of 127.0.0.1.  [default: a free one]")
@click.option("--no-browser", is_flag=True, help="Print the address, and open no browser.")
@click.option("--filter", "query", default="", help="As in the page's address: 'task=grasp&failure=missed&q=lift_m>0'.")
@click.option("--episode", metavar="ID", help="Open this one.")
def view(release_or_run: str | None, port: int, no_browser: bool, query: str, episode: str | None) -> None:
    """Browse every episode of a release or of a run folder in a page, without any network.

    RELEASE_OR_RUN is the name of a release, its folder, or a run folder of `rema evaluate`; by default the newest
    release on this machine. The page is served to this machine alone until Ctrl-C.
    """
    from evaluator.cli.progress import StderrProgress
    from evaluator.view import Viewer, open_source, serving
    from evaluator.view.query import parse_query
    from evaluator.view.viewer import LINK

    with StderrProgress() as progress:
        source = open_source(release_or_run, progress)
    viewer = Viewer(source)
    viewer.select(parse_query(query, LINK))
    if episode is not None:
        viewer.place(episode)
    for notice in source.notices:
        note(f"{notice.message}\n{notice.hint}".strip())
    opened = [query] if query else []
    opened += [urlencode({"episode": episode}, safe="/")] if episode else []
    with serving(viewer, port, note) as address:
        link = address + (f"#{quote('&'.join(opened), safe='/=&%+<>')}" if opened else "")
        line(link)
        note(f"serving {len(source.table):,} episodes of {source.name}; stop with Ctrl-C")
        if not no_browser and not webbrowser.open(link):
            note("no browser was found: open the address yourself")
        with suppress(interrupts.Interrupted):  # the ordinary end
            while True:
                interrupts.check()
                time.sleep(interrupts.POLL_S)
