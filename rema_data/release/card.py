"""The card of a release: datasheet, Croissant description, licence and citation, written beside the data.

The card depends on the manifest only: sealing the same data twice gives the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from rema_data.release.croissant import croissant
from rema_data.release.datasheet import datasheet
from rema_data.release.licences import licence_notice, licence_url
from rema_data.release.manifest import Manifest
from rema_data.storage import write_atomic

__all__ = ["CARD", "citation_file", "write_card"]

CARD = ("CITATION.cff", "DATASHEET.md", "LICENSE", "croissant.json")
"""Files of the card, in the release's own folder."""

_PAPER = """\
references:
  - type: article
    title: "Tool as Embodiment for Recursive Manipulation"
    authors:
      - family-names: Noguchi
        given-names: Yuki
      - family-names: Matsushima
        given-names: Tatsuya
      - family-names: Matsuo
        given-names: Yutaka
      - family-names: Gu
        given-names: Shixiang Shane
    year: 2021
    url: "https://arxiv.org/abs/2112.00359"
"""


def write_card(folder: Path, manifest: Manifest, version: int | None = None) -> None:
    """Write the card of a release that is about to be sealed; ``manifest`` is a draft that lists the data files.

    ``version`` is the earliest schema version of the release's own tables, by default that of the release.
    """
    description = json.dumps(croissant(manifest, version=version), indent=1, ensure_ascii=False) + "\n"
    texts = (_citation(manifest), datasheet(manifest), licence_notice(manifest), description)
    for name, text in zip(CARD, texts, strict=True):
        write_atomic(folder / name, text)


def _citation(manifest: Manifest) -> str:
    dated = {"date-released": manifest.published} if manifest.published else {}
    fields = {
        "message": f"If you use this release, please cite it: {manifest.citation}",
        "title": manifest.title,
        "type": "dataset",
        "version": manifest.name,
        **dated,
        "license": manifest.license,
        "license-url": licence_url(manifest.license),
        "abstract": manifest.description,
    }
    return citation_file(fields, f"The authors of {manifest.name}")


def citation_file(fields: Mapping[str, str], authors: str) -> str:
    """Citation File Format 1.2.0, with the paper as a reference. JSON strings are valid YAML."""
    lines = [f"{name}: {json.dumps(value, ensure_ascii=False)}" for name, value in fields.items()]
    return "\n".join(["cff-version: 1.2.0", *lines, "authors:", f"  - name: {json.dumps(authors)}", _PAPER])
