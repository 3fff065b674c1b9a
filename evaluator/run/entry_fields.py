"""Fields of an entry that other people read: each has a form, and none is free text."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, PositiveInt

from evaluator.run.header import Sha256
from rema_data.validation import record

__all__ = ["EntryKind", "Environment", "Fingerprint", "Isolation", "Link", "Marks", "Name"]


def _name(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.+-]{0,63}", name):
        rule = "use 1 to 64 letters, digits and _.+- that begin with a letter or a digit"
        raise ValueError(f"{name!r} cannot be a policy's name: {rule}")
    return name


def _link(link: str) -> str:
    if link and not re.fullmatch(r"https?://[A-Za-z0-9._~:/?#@!$&()*+,;=%-]{1,200}", link):
        raise ValueError(f"{link!r} is not an address: give a plain https:// address")
    return link


Name = Annotated[str, AfterValidator(_name)]
"""A policy's name as the board shows it."""
Link = Annotated[str, AfterValidator(_link)]
"""The address of a policy's paper or code, or nothing."""
_Plain = Annotated[str, Field(pattern="^[A-Za-z0-9_.-]{1,80}$")]
Fingerprint = Annotated[dict[_Plain, _Plain], Field(min_length=1)]
"""Identity of a simulator."""
EntryKind = Literal["submitted", "simulator", "privileged", "learned", "heuristic", "random"]
"""What a policy is. Only an installed policy is of one of the last three kinds."""
Isolation = Literal["L1", "L2", "L3"]
"""Levels of the sandbox."""
_Version = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.+!-]{1,40}$")]
_Machine = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.,@()/+ -]{1,100}$")]


@record
class Marks:
    """What was evaluated, by which rules and with which simulator."""

    policy_digest: Sha256
    protocol_hash: Sha256
    scenarios_hash: Sha256
    fingerprint: Fingerprint


@record
class Environment:
    """Versions and machine of the run, for people."""

    rema: _Version | None = None
    python: _Version | None = None
    numpy: _Version | None = None
    pybullet: _Version | None = None
    torch: _Version | None = None
    openvino: _Version | None = None
    system: _Machine | None = None
    architecture: _Machine | None = None
    processor: _Machine | None = None
    commit: Annotated[str, Field(pattern="^[0-9a-f]{40}$")] | None = None
    dirty: bool | None = None
    engine: _Version | None = None
    device: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.:-]{1,40}$")] | None = None
    segments: PositiveInt = 1
