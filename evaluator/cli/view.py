"""``rema view``: every episode of a release or of a run, in a page."""

from __future__ import annotations

import time
import webbrowser
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any
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
@click.option("--mp4", type=click.Path(path_type=Path), help="Write the film of --episode (needs rema[video]).")
@click.option("--rrd", type=click.Path(path_type=Path), help="Write --episode for Rerun (needs rema[rerun]).")
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
    mp4: Path | None,
    rrd: Path | None,
    as_json: bool,
) -> None:
    """Browse every episode of a release or of a run in a page, without any network.

    RELEASE_OR_RUN is the name of a release, its folder, or a run folder of `rema evaluate`; by default the newest
    release on this machine. The page is served to this machine alone, until Ctrl-C. With --output it is a file that
    needs no server; --mp4 and --rrd write one episode.
    """
    writing = not (output is None and mp4 is None and rrd is None)
    served = {"--port": port is not None, "--no-browser": no_browser}
    paged = {"--episodes": episodes is not None, "--play": play}
    single = {"--mp4": mp4 is not None, "--rrd": rrd is not None}
    _refuse(served, writing, "is for serving", "drop it, or --output, --mp4 and --rrd")
    _refuse(paged, output is None, "is for a page in a file", "add --output FILE.html")
    _refuse({"--json": as_json}, not writing, "is for files", "add --output FILE.html")
    _refuse(single, episode is None, "writes one episode", "name it with --episode ID")
    # Imported here, so that a mistyped option is answered at once.
    from evaluator.cli.progress import StderrProgress
    from evaluator.view import Viewer, open_source, write_page
    from evaluator.view.query import parse_query
    from evaluator.view.static import spread
    from evaluator.view.viewer import LINK

    files: list[dict[str, Any]] = []
    with StderrProgress() as progress:
        source = open_source(release_or_run, progress)
        viewer = Viewer(source)
        selected = viewer.select(parse_query(query, LINK)).rows.tolist()
        place = None if episode is None else viewer.place(episode)
        for notice in source.notices:
            progress.note(f"{notice.message}\n{notice.hint}".strip())
        if writing:
            needed = play or any(single.values())  # maps of a release do without
            with suppress(*(() if needed else (RemaError,))):
                import_pybullet()
        if output is not None:
            places = spread(selected, episodes or _EPISODES) if place is None else [place]
            write_page(viewer, places, output, play=play, progress=progress)
            files.append({"file": output, "episodes": len(places)})
        if episode is not None and mp4 is not None:
            from evaluator.view.video import write_video

            files.append({"file": mp4, "frames": write_video(viewer, episode, mp4, progress)})
        if episode is not None and rrd is not None:
            from evaluator.view.recording import write_recording

            files.append({"file": rrd, "steps": write_recording(viewer, episode, rrd, progress)})
    if not writing:
        _serve(viewer, port or 0, not no_browser, query, episode)
        return
    for about in files:
        path = about["file"]
        about.update(file=str(path), bytes=path.stat().st_size)
        if not as_json:
            count, what = next((about[name], name) for name in ("episodes", "frames", "steps") if name in about)
            plural = what.removesuffix("s") if count == 1 else what
            line(f"{path}: {about['bytes'] / _MEGABYTE:.1f} MB, {count} {plural}")
    if as_json:
        print_json({"files": files})


def _refuse(options: Mapping[str, bool], where: bool, why: str, way: str) -> None:
    """Raise InputError for an option that was given where it has no meaning."""
    for option, given in options.items():
        if given and where:
            raise InputError(f"{option} {why}", hint=way)


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
