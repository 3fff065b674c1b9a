"""Networks as a folder that is ready for a model repository, and that ``rema evaluate tae --checkpoint`` plays."""

from __future__ import annotations

import shutil
from pathlib import Path

from baselines.publish.model_card import model_card, rate_table
from baselines.tae.checkpoint import CARD, WEIGHTS, networks_in
from evaluator.leaderboard import leaderboard
from evaluator.leaderboard.naming import installed_digest
from evaluator.policy.named import find_named
from evaluator.policy.shipped import shipped_checkpoint, shipped_policies
from evaluator.run.entry import find_entries
from rema_data import interrupts
from rema_data.errors import InputError
from rema_data.publish import Published, publication
from rema_data.release.card import citation_file
from rema_data.release.licences import KNOWN_LICENCES, licence_url, weights_notice
from rema_data.storage import absolute, write_atomic

__all__ = ["is_networks", "publish_networks"]

_LICENCE = "MIT"
"""Of the networks that come with rema."""


def is_networks(what: str) -> bool:
    """Whether a word names networks: those of a built-in policy, or a folder of them."""
    return what in shipped_policies() or any(absolute(what).glob(f"*{WEIGHTS}"))


def publish_networks(what: str, target: Path, licence: str = "") -> Published:
    """Write the networks of a built-in policy, or of a folder, into the new folder ``target``.

    Of a policy, they are those that play most tasks; networks of single tasks are published by their folder.

    ``licence`` is the SPDX identifier for networks of your own; those of rema have one.

    Raises InputError for networks of a folder without a licence, and MissingFileError, IntegrityError or InputError
    where weights or cards are not those that belong together; RunMismatchError where ``target`` holds something,
    StorageError where the disk is full or may not be written. ``target`` is then as it was before.
    """
    place = shipped_checkpoint(what)
    if place is None:
        place = absolute(what)
        if licence not in KNOWN_LICENCES:
            problem = f"{licence!r:.40} is not a licence that is known" if licence else "these networks have no licence"
            raise InputError(problem, hint=f"choose one of them with --license: {', '.join(KNOWN_LICENCES)}")
        title, about, rates = place.resolve().name, "Networks for the tasks of ReMa.", ""
    elif licence not in ("", _LICENCE):
        raise InputError(f"the networks of {what} have the licence {_LICENCE}", hint="leave out --license")
    else:
        named, licence = find_named(what), _LICENCE
        title, about = what, "" if named is None else named.description
        others = shipped_policies()[what].tasks  # other networks play these
        rows = [
            row
            for row in leaderboard(find_entries(), published=False).rows
            if row.task not in others and row.policy_digest == installed_digest(what, row.task)
        ]
        rates = rate_table(what, rows)
    networks = networks_in(place)
    with interrupts.held(), publication(target) as folder:
        for file in networks.values():
            for suffix in (WEIGHTS, CARD):
                interrupts.check()
                shutil.copyfile(file.with_suffix(suffix), folder / f"{file.stem}{suffix}")
        copies = networks_in(folder)
        write_atomic(folder / "README.md", model_card(title, about, licence, copies, rates))  # and checks every network
        write_atomic(folder / "LICENSE", weights_notice(title, licence))
        fields = {
            "message": "If you use these networks, please cite them, and the paper that they follow.",
            "title": f"{title}: networks for the tasks of ReMa",
            "type": "software",
            "license": licence,
            "license-url": licence_url(licence),
        }
        write_atomic(folder / "CITATION.cff", citation_file(fields, f"The authors of {title}"))
    files = list(target.iterdir())
    return Published(target, "model", len(files), sum(path.stat().st_size for path in files))
