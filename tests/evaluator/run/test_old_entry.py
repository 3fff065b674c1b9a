"""Entries of format 1: a changed file is refused by name, also where its seal was made again."""

from __future__ import annotations

import base64
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from evaluator.run.entry import read_entry, seal
from rema_data.errors import IntegrityError

ENTRY = Path(__file__).resolve().parents[2] / "data" / "runs" / "entry-format-1.json"


@pytest.fixture
def entry_file(tmp_path: Path) -> Path:
    return Path(shutil.copy(ENTRY, tmp_path / "entry.json"))


def change(path: Path, edit: Callable[[dict[str, Any]], None], resealed: bool = False) -> None:
    content = json.loads(path.read_text())
    edit(content)
    if resealed:
        content["sha256"] = seal(content)
    path.write_text(json.dumps(content))


def test_any_change_breaks_the_seal(entry_file: Path) -> None:
    change(entry_file, lambda content: content["policy"].update(name="better_policy"))
    with pytest.raises(IntegrityError, match=r"entry\.json is refused: its content has sha256"):
        read_entry(entry_file)


def more_successes(content: dict[str, Any]) -> None:
    content["counts"]["successes"] += 1
    content["counts"]["failures"]["missed"] -= 1
    content["counts"]["funnel"][0]["succeeded"] += 1


def flipped_bit(content: dict[str, Any]) -> None:
    bits = bytearray(base64.b64decode(content["outcomes"]["success"]))
    bits[0] ^= 0b0100_0000
    content["outcomes"]["success"] = base64.b64encode(bytes(bits)).decode()


def bit_behind_the_end(content: dict[str, Any]) -> None:
    bits = bytearray(base64.b64decode(content["outcomes"]["eligible"]))
    bits[-1] |= 1
    content["outcomes"]["eligible"] = base64.b64encode(bytes(bits)).decode()


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (more_successes, "its outcomes hold 119 successes of 300 episodes, its counts say 120"),
        (flipped_bit, "its outcomes hold 118 successes|its outcomes hold 120 successes"),
        (bit_behind_the_end, "behind the last episode"),
        (lambda c: c["outcomes"].update(success="AAAA" * 3), "bytes of outcomes"),
        (lambda c: c["outcomes"].update(success="not base64!"), "refused"),
        (lambda c: c["counts"].update(policy_errors=1), "do not add up"),
        (lambda c: c["counts"].update(infra_errors=2), "do not add up"),
        (lambda c: c["counts"]["failures"].update(slipped=3), "do not add up"),
        (lambda c: c["counts"]["failures"].update(bored=0), "failure labels"),
        (lambda c: c["counts"].update(eligible=300.0), r"counts\.eligible is 300\.0"),
        (lambda c: c["counts"]["funnel"].append({"step": 1, "attempted": 1, "succeeded": 1}), "do not add up"),
        (lambda c: c["audit"].update(action_flips=31), "audit has more flips than repeats"),
        (lambda c: c["audit"].update(outcomes=-1), r"audit\.outcomes is -1"),
        (lambda c: c["policy"].update(name="\u001b[31mred"), "cannot be a policy's name"),
        (lambda c: c["policy"].update(link="javascript:alert(1)"), "is not an address"),
        (lambda c: c["policy"].update(privileged="no"), r"policy\.privileged is 'no'"),
        (lambda c: c["marks"].update(policy_digest="x"), r"marks\.policy_digest is 'x'"),
        (lambda c: c["marks"].update(fingerprint={}), "fingerprint"),
        (lambda c: c["marks"].update(fingerprint={"probe": "<b>"}), "fingerprint"),
        (lambda c: c["evidence"].update(seal=None), r"evidence\.seal is None"),
        (lambda c: c["provenance"].update(rema=[1]), r"provenance\.rema"),
        (lambda c: c.update(task="fly"), "task 'fly'"),
        (lambda c: c.update(format="1"), "format is '1'"),
        (lambda c: c.update(extra=1), "extra is not a known field"),
        (lambda c: c.pop("marks"), "marks is missing"),
    ],
)
def test_a_new_seal_does_not_hide_what_cannot_be(
    entry_file: Path, edit: Callable[[dict[str, Any]], None], message: str
) -> None:
    change(entry_file, edit, resealed=True)
    with pytest.raises(IntegrityError, match=message) as caught:
        read_entry(entry_file)
    assert str(entry_file) in caught.value.message and caught.value.exit_code == 6
