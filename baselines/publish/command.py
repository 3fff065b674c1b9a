"""``rema publish``: a release, or networks, as a folder that is ready to be pushed to a repository."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import click

from evaluator.cli.options import json_option
from evaluator.cli.output import line, print_json

if TYPE_CHECKING:
    from rema_data.publish import Published

__all__ = ["publish"]


@click.command()
@click.argument("what")
@click.option("--to", "target", required=True, type=click.Path(path_type=Path), help="The new folder.")
@click.option("--repo", default="", metavar="ORG/NAME", help="Of the hub: its name goes into the commands of the card.")
@click.option("--viewer/--no-viewer", default=True, help="Of a release: also its steps in Parquet.  [default: yes]")
@click.option("--license", "licence", default="", metavar="SPDX", help="Of networks of your own, such as MIT.")
@json_option
def publish(what: str, target: Path, repo: str, viewer: bool, licence: str, as_json: bool) -> None:
    """Write WHAT into a folder that is ready to be pushed to a repository of the Hugging Face Hub.

    WHAT is a release (name or folder), the name of a policy whose networks come with rema, or a folder of networks that
    `rema train` made. Nothing is uploaded. The folder of a release is a source of `rema download`, also behind
    hf://datasets/ORG/NAME; that of networks is played by `rema evaluate tae --checkpoint FOLDER`.
    """
    from rema_data.publish.folder import check_repository

    if repo:
        check_repository(repo)
    done = _publish(what, target, repo, viewer, licence)
    if as_json:
        print_json({**dataclasses.asdict(done), "path": str(done.path)})
        return
    from rich.filesize import decimal

    line(f"{done.path}: {done.files} files, {decimal(done.bytes)}")
    line(f"to upload it: hf upload {repo or 'ORG/NAME'} {done.path} . --repo-type {done.kind}")


def _publish(what: str, target: Path, repo: str, viewer: bool, licence: str) -> Published:
    from baselines.publish.networks import is_networks, publish_networks
    from evaluator.cli.progress import StderrProgress
    from rema_data.errors import InputError
    from rema_data.publish import publish_release
    from rema_data.release.folder import find_release

    if is_networks(what):
        return publish_networks(what, target, licence)
    if licence:
        raise InputError("a release has its licence in its manifest", hint="leave out --license")
    release = find_release(what)
    with StderrProgress() as progress:
        return publish_release(release, target, repo, viewer=viewer, progress=progress)
