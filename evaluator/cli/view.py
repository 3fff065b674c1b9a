"""``rema view``: every episode of a release or of a run, in a page."""

from __future__ import annotations

import time
import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote, urlencode

import click

from evaluator.cli.options import json_option
from evaluator.cli.output import line, note, print_json
from evaluator.cli.quiet import import_pybullet
from rema_data import interrupts
from rema_data.errors import InputError, RemaError

if TYPE_CHECKING:
    from evaluator.view import Viewer

__all__ = ["view"]

_MEGABYTE = 1_000_000
_EPISODES = 200


@click.command()
@click.argument("release_or_run", required=False)
@click.option("--filter", "query", default="", help="As in the page's address: 'task=grasp&failure=missed&q=lift_m>0'.")
@click.option("--episode", metavar="ID", help="Open this one, such as round-1/grasp/train/0.")
@click.option("--port", type=click.IntRange(0, 65535), help="Of 127.0.0.1.  [default: a free one]")
@click.option("--no-browser", is_flag=True, help="Print the address, and open no browser.")
@click.option("--output", type=click.Path(path_type=Path), help="Write an HTML file instead of serving.")
@click.option("--episodes", type=click.IntRange(1, 5000), help=f"Of the file, spread evenly.  [default: {_EPISODES}]")
@click.option("--play", is_flag=True, help="The file also has photographs and films: some seconds a step.")
@json_option
def view(
    release_or_run: str | None,
    query: str,
    episode: str | None,
    port: int | None,
    no_browser: bool,
    output: Path | None,
    episodes: int | None,
    play: bool,
    as_json: bool,
) -> None:
    """Browse every episode of a release or of a run in a page, without any network.

    RELEASE_OR_RUN is the name of a release, its folder, or a run folder of `rema evaluate`; by default the newest
    release on this machine. The page is served to this machine alone, until Ctrl-C. With --output it is a file that
    needs no server.
    """
    serving_only = {"--port": port is not None, "--no-browser": no_browser}
    writing_only = {"--episodes": episodes is not None, "--play": play, "--json": as_json}
    for option, given in (writing_only if output is None else serving_only).items():
        if given:
            way = "drop it, or add --output FILE.html" if output is None else f"drop {option} or --output"
            raise InputError(f"{option} is for {'a file' if output is None else 'serving'}", hint=way)
    # Imported here, so that a mistyped option is answered at once.
    from evaluator.cli.progress import StderrProgress
    from evaluator.view import Viewer, open_source, write_page
    from evaluator.view.query import parse_query
    from evaluator.view.static import spread
    from evaluator.view.viewer import LINK

    with StderrProgress() as progress:
        source = open_source(release_or_run, progress)
        viewer = Viewer(source)
        selected = viewer.select(parse_query(query, LINK)).rows.tolist()
        place = None if episode is None else viewer.place(episode)
        for notice in source.notices:
            progress.note(f"{notice.message}\n{notice.hint}".strip())
        if output is not None:
            if play:
                import_pybullet()
            places = spread(selected, episodes or _EPISODES) if place is None else [place]
            written = write_page(viewer, places, output, play=play, progress=progress)
    if output is None:
        _serve(viewer, port or 0, not no_browser, query, episode)
    elif as_json:
        print_json({"file": str(written.path), "bytes": written.size, "episodes": written.episodes})
    else:
        plural = "" if written.episodes == 1 else "s"
        line(f"{written.path}: {written.size / _MEGABYTE:.1f} MB, {written.episodes} episode{plural}")


def _serve(viewer: Viewer, port: int, browser: bool, query: str, episode: str | None) -> None:
    from evaluator.view import serving

    opened = [query] if query else []
    opened += [urlencode({"episode": episode}, safe="/")] if episode else []
    with serving(viewer, port, note) as address:
        link = address + (f"#{quote('&'.join(opened), safe='/=&%+')}" if opened else "")
        line(link)
        note(f"serving {len(viewer.source.table):,} episodes of {viewer.source.name}; stop with Ctrl-C")
        if browser and not webbrowser.open(link):
            note("no browser was found: open the address yourself")
        with suppress(RemaError):  # without PyBullet there is everything but the pictures of a simulation
            import_pybullet()
        with suppress(interrupts.Interrupted):  # the ordinary end
            while True:
                interrupts.check()
                time.sleep(interrupts.POLL_S)
