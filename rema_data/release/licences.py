"""Licences of data by their SPDX identifier: where the text is, and the notice that goes with a release."""

from __future__ import annotations

from rema_data.release.manifest import Manifest

__all__ = ["KNOWN_LICENCES", "hub_licence", "licence_notice", "licence_url", "weights_notice"]

KNOWN_LICENCES = (
    "CC-BY-4.0",
    "CC-BY-SA-4.0",
    "CC-BY-NC-4.0",
    "CC-BY-NC-SA-4.0",
    "CC-BY-ND-4.0",
    "CC-BY-NC-ND-4.0",
    "CC0-1.0",
    "PDDL-1.0",
    "ODC-By-1.0",
    "ODbL-1.0",
    "CDLA-Permissive-1.0",
    "CDLA-Permissive-2.0",
    "CDLA-Sharing-1.0",
    "MIT",
    "Apache-2.0",
)
"""SPDX identifiers that a new release may have. The notice, the citation and Croissant link to the text at
``licence_url``, which exists for an identifier of SPDX and for nothing else."""

_CREATIVE_COMMONS = {
    "CC-BY-4.0": ("Creative Commons Attribution 4.0 International", "https://creativecommons.org/licenses/by/4.0/"),
    "CC0-1.0": ("Creative Commons Zero 1.0 Universal", "https://creativecommons.org/publicdomain/zero/1.0/"),
}
_ON_HUB = {"PDDL-1.0": "pddl", "ODC-By-1.0": "odc-by", "ODbL-1.0": "odbl"}
_TERMS = {
    "CC-BY-4.0": "You may copy, share and adapt it for any purpose, also commercially, if you name its source, link to "
    "the licence\nand say what you changed.",
    "CC0-1.0": "Its authors have waived their rights: you may use it for any purpose without asking.",
}


def hub_licence(identifier: str) -> str:
    """What the Hugging Face Hub calls a licence."""
    return _ON_HUB.get(identifier, identifier.lower())


def licence_url(identifier: str) -> str:
    """Where the text of a licence is."""
    if identifier in _CREATIVE_COMMONS:
        return _CREATIVE_COMMONS[identifier][1]
    return f"https://spdx.org/licenses/{identifier}.html"


def weights_notice(title: str, identifier: str) -> str:
    """The file LICENSE of networks."""
    return (
        f"{title}\n\nThese weights are licensed under {identifier}.\nSPDX-License-Identifier: {identifier}\n\n"
        f"Full text: {licence_url(identifier)}\n"
    )


def licence_notice(manifest: Manifest) -> str:
    """The file LICENSE of a release: a notice that points to the whole text."""
    identifier = manifest.license
    name = _CREATIVE_COMMONS.get(identifier, (identifier, ""))[0]
    terms = f"\n{_TERMS[identifier]}\n" if identifier in _TERMS else ""
    return (
        f"{manifest.title} ({manifest.name})\n\n"
        f"The data of this release are licensed under {name}.\n"
        f"SPDX-License-Identifier: {identifier}\n{terms}\n"
        f"Full text: {licence_url(identifier)}\n\n"
        f"Please cite: {manifest.citation}\n"
    )
