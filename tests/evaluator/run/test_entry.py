"""Entries: reading gives the actions that were written; nothing can be claimed; a changed file is refused by name."""

from __future__ import annotations

import base64
import dataclasses
import json
import shutil
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluator.run.actions import NOT_ASKED, POLICY_ERROR
from evaluator.run.entry import MAX_BYTES, encode, read_entry, seal
from evaluator.run.reading import read_run
from rema_data import grid
from rema_data.errors import InputError, IntegrityError, MissingFileError

DATA = Path(__file__).resolve().parents[2] / "data" / "runs"
ENTRY = DATA / "entry-format-2.json"
EPISODES, STEPS = 300, 2


@pytest.fixture(autouse=True)
def _lists(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REMA_MANIFESTS", str(DATA / "manifests"))


@pytest.fixture
def entry_file(tmp_path: Path) -> Path:
    return Path(shutil.copy(ENTRY, tmp_path / "entry.json"))


def change(path: Path, edit: Callable[[dict[str, Any]], Any], resealed: bool = True) -> None:
    content = json.loads(path.read_text())
    edit(content)
    if resealed:
        content["sha256"] = seal(content)
    path.write_text(json.dumps(content))


def packed(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 9)).decode()


def test_reading_gives_what_was_written(tmp_path: Path) -> None:
    run = read_entry(ENTRY)
    generator = np.random.default_rng(1)
    for _ in range(5):
        actions = generator.integers(0, grid.ACTIONS - 2, (EPISODES, STEPS)).astype(np.uint16)
        actions[generator.random((EPISODES, STEPS)) < 0.1] = POLICY_ERROR
        actions[generator.random((EPISODES, STEPS)) < 0.1] = NOT_ASKED
        path = tmp_path / "entry.json"
        path.write_bytes(encode(dataclasses.replace(run, recorded=actions, policy="other", isolation="L2")))
        found = read_entry(path)
        assert np.array_equal(found.actions, actions) and (found.policy, found.isolation) == ("other", "L2")
        assert path.stat().st_size <= MAX_BYTES


def test_a_full_list_of_the_longest_task_fits() -> None:
    noise = np.random.default_rng(1).integers(0, grid.ACTIONS, (10_000, 4)).astype(np.uint16)
    assert len(packed(noise.tobytes())) + 5_000 < MAX_BYTES


def test_an_entry_holds_no_result() -> None:
    entry = read_run(ENTRY)
    assert not entry.has_counts and not entry.verified and entry.kind == "entry" and entry.tag == "submitted"
    for what in ("counts", "outcomes", "table", "summary"):
        with pytest.raises(InputError, match="is an entry"):
            getattr(entry, what)
    with pytest.raises(InputError, match="is an entry"):
        read_run(ENTRY, with_findings=True)
    words = json.loads(ENTRY.read_text())
    assert words.keys().isdisjoint({"counts", "rate", "outcomes", "audit", "success"})


def test_any_change_breaks_the_seal(entry_file: Path) -> None:
    change(entry_file, lambda content: content["policy"].update(name="better_policy"), resealed=False)
    with pytest.raises(IntegrityError, match=r"entry\.json is refused: its content has sha256"):
        read_entry(entry_file)


BOMB = packed(bytes(1 << 26))


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda c: c.update(counts={"successes": 300}), "counts is not a known field"),
        (lambda c: c.update(rate=1.0), "rate is not a known field"),
        (lambda c: c["policy"].update(name="\u001b[31mred"), "cannot be a policy's name"),
        (lambda c: c["policy"].update(name="two words"), "cannot be a policy's name"),
        (lambda c: c["policy"].update(link="javascript:alert(1)"), "is not an address"),
        (lambda c: c["policy"].update(kind="best"), r"policy\.kind is 'best'"),
        (lambda c: c["policy"].update(kind="published"), r"policy\.kind is 'published'"),
        (lambda c: c["policy"].update(privileged=False), r"policy\.privileged is not a known field"),
        (lambda c: c.update(isolation="L9, and audited"), "isolation is 'L9"),
        (lambda c: c["environment"].update(rema="1.0 <b>"), r"environment\.rema"),
        (lambda c: c["environment"].update(note="hello"), r"environment\.note is not a known field"),
        (lambda c: c["environment"].update(commit="main"), r"environment\.commit"),
        (lambda c: c["marks"].update(policy_digest="x"), r"marks\.policy_digest is 'x'"),
        (lambda c: c["marks"].update(fingerprint={}), "fingerprint"),
        (lambda c: c["marks"].update(fingerprint={"probe": "<b>"}), "fingerprint"),
        (lambda c: c["marks"].update(scenarios_hash="0" * 64), "its scenario list 0+ is not here"),
        (lambda c: c.update(split="val"), "split is 'val'"),
        (lambda c: c.update(task="fly"), "task 'fly'"),
        (lambda c: c.update(protocol="conditional"), "does not hold the 600 bytes"),
        (lambda c: c.update(actions=packed(bytes(2 * STEPS * (EPISODES - 1)))), "does not hold the 1,200 bytes"),
        (lambda c: c.update(actions=packed(bytes(2 * STEPS * (EPISODES + 1)))), "does not hold the 1,200 bytes"),
        (lambda c: c.update(actions=packed(bytes(2 * STEPS * EPISODES))[:-8]), "does not hold|cannot be decompressed"),
        (lambda c: c.update(actions=BOMB), "does not hold the 1,200 bytes"),
        (lambda c: c.update(actions="not base64!"), "refused"),
        (lambda c: c.update(actions="AAAA"), "cannot be decompressed"),
        (lambda c: c.update(format=3), "has format 3; this version of rema reads formats up to 2"),
        (lambda c: c.update(format="2"), "format is '2'"),
        (lambda c: c.pop("marks"), "marks is missing"),
    ],
)
def test_a_new_seal_does_not_hide_what_cannot_be(
    entry_file: Path, edit: Callable[[dict[str, Any]], Any], message: str
) -> None:
    change(entry_file, edit)
    with pytest.raises(IntegrityError, match=message) as caught:
        read_entry(entry_file)
    assert str(entry_file) in caught.value.message and caught.value.exit_code == 6


@pytest.mark.parametrize("content", [b"", b"[]", b"{", b"\xff\xfe", b"[" * 3000, b" " * (MAX_BYTES + 1), b"null"])
def test_files_that_are_not_entries(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "odd.json"
    path.write_bytes(content)
    with pytest.raises(IntegrityError, match=r"odd\.json is refused"):
        read_entry(path)
    with pytest.raises(MissingFileError):
        read_entry(tmp_path / "none.json")
