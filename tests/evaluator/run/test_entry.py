"""Submission files: reading returns what was written, and a changed file is refused by name."""

from __future__ import annotations

import base64
import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluator.leaderboard.submission import make_entry
from evaluator.policy.named import policy_names
from evaluator.run.counts import Counts, FunnelStep
from evaluator.run.entry import MAX_BYTES, encode, read_entry, seal
from evaluator.run.reading import read_run
from evaluator.run.run import Outcomes, Provenance, Run
from evaluator.run.summary import Audit
from rema_data.errors import InputError, IntegrityError, MissingFileError
from rema_data.schema import Failure
from tests.evaluator.runs import solved, write_manifests, write_run


def entry_of(eligible: list[bool], success: list[bool], policy: str = "my_policy") -> Run:
    measured = np.array(eligible, bool)
    passed = np.array(success, bool) & measured
    failed = int(measured.sum() - passed.sum())
    counts = Counts(
        episodes=len(measured),
        eligible=int(measured.sum()),
        successes=int(passed.sum()),
        failures={"missed": failed} if failed else {},
        policy_errors=0,
        infra_errors=int((~measured).sum()),
        funnel=(FunnelStep(0, int(measured.sum()), int(passed.sum())),),
    )
    environment = {"rema": "0.1.0", "commit": None, "dirty": False, "segments": 2}
    return Run(
        source=Path("x"),
        policy=policy,
        privileged=False,
        task="grasp",
        split="test",
        protocol="conditional",
        provenance=Provenance(
            "1" * 64, "2" * 64, "3" * 64, {"pybullet": "3.2.7"}, environment, merkle_root="4" * 64, seal="5" * 64
        ),
        audit=Audit(30, 1, 30, 0),
        link="https://example.org/paper",
        packed=(counts, Outcomes(measured, passed)),
    )


@pytest.fixture
def entry_file(tmp_path: Path) -> Path:
    path = tmp_path / "entry.json"
    path.write_bytes(encode(entry_of([True] * 19 + [False], [n % 3 == 0 for n in range(20)])))
    return path


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=70))
def test_what_is_packed_comes_out_again(
    tmp_path_factory: pytest.TempPathFactory, pairs: list[tuple[bool, bool]]
) -> None:
    entry = entry_of([pair[0] for pair in pairs], [pair[1] for pair in pairs])
    path = tmp_path_factory.mktemp("entry") / "entry.json"
    path.write_bytes(encode(entry))
    found = read_entry(path)
    for name in ("policy", "privileged", "task", "split", "protocol", "counts", "provenance", "audit", "link"):
        assert getattr(found, name) == getattr(entry, name)
    assert np.array_equal(found.outcomes.eligible, entry.outcomes.eligible)
    assert np.array_equal(found.outcomes.success, entry.outcomes.success)
    assert encode(found) == encode(entry)


def test_ten_thousand_episodes_with_every_failure_fit() -> None:
    """Outcomes are random, names as long as they may be: the largest entry there is."""
    bits = np.random.default_rng(1).random(10_000) < 0.5
    entry = entry_of([True] * 10_000, bits.tolist(), policy="n" * 64)
    labels = [label.value for label in Failure if label is not Failure.POLICY_ERROR]
    left = entry.counts.failures["missed"]
    entry.counts.failures.update(dict.fromkeys(labels, 1000), missed=left)
    assert len(encode(entry)) < MAX_BYTES - 2000


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


def success_of_a_lost_episode(content: dict[str, Any]) -> None:
    bits = bytearray(base64.b64decode(content["outcomes"]["success"]))
    bits[0] ^= 0b1000_0000
    bits[2] ^= 0b0001_0000
    content["outcomes"]["success"] = base64.b64encode(bytes(bits)).decode()


def bit_behind_the_end(content: dict[str, Any]) -> None:
    bits = bytearray(base64.b64decode(content["outcomes"]["eligible"]))
    bits[-1] |= 1
    content["outcomes"]["eligible"] = base64.b64encode(bytes(bits)).decode()


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (more_successes, "its outcomes hold 7 successes of 19 episodes, its counts say 8"),
        (flipped_bit, "its outcomes hold 8 successes"),
        (success_of_a_lost_episode, "its outcomes hold 6 successes"),
        (bit_behind_the_end, "behind the last episode"),
        (lambda c: c["outcomes"].update(success="AAAA" * 3), "bytes of outcomes"),
        (lambda c: c["outcomes"].update(success="not base64!"), "refused"),
        (lambda c: c["counts"].update(policy_errors=1), "do not add up"),
        (lambda c: c["counts"].update(infra_errors=2), "do not add up"),
        (lambda c: c["counts"]["failures"].update(slipped=3), "do not add up"),
        (lambda c: c["counts"]["failures"].update(bored=0), "failure labels"),
        (lambda c: c["counts"].update(eligible=19.0), r"counts\.eligible is 19\.0"),
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
        (lambda c: c.update(format=2), "has format 2; this version of rema reads formats up to 1"),
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


@pytest.mark.parametrize("content", [b"", b"[]", b"{", b"\xff\xfe", b"[" * 3000, b" " * (MAX_BYTES + 1), b"null"])
def test_files_that_are_not_entries(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "odd.json"
    path.write_bytes(content)
    with pytest.raises(IntegrityError, match=r"odd\.json is refused"):
        read_entry(path)


def test_a_run_and_its_entry_say_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_manifests(tmp_path / "manifests")
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    folder = write_run(tmp_path / "run", solved(0.4, 1))
    path = tmp_path / "entry.json"
    path.write_bytes(encode(make_entry(folder)))
    run, entry = read_run(folder), read_run(path)
    assert (run.kind, entry.kind) == ("run", "entry")
    assert (run.counts, run.provenance, run.audit) == (entry.counts, entry.provenance, entry.audit)
    assert encode(run) == encode(entry)
    with pytest.raises(MissingFileError):
        read_run(tmp_path / "none")
    with pytest.raises(InputError, match="is a submission file"):
        read_run(path, with_findings=True)
    with pytest.raises(InputError, match="is a submission file"):
        _ = entry.table


def test_only_built_in_names_are_tagged_as_ours() -> None:
    for name in policy_names():
        assert entry_of([True], [True], name).tag in ("random", "privileged", "learned")
    for name in ("joint", "random.py", "tae-joint.py", "my_policy"):
        assert entry_of([True], [True], name).tag == "submitted"


def test_an_entry_needs_an_audit() -> None:
    with pytest.raises(InputError, match="no audit"):
        encode(dataclasses.replace(entry_of([True], [True]), audit=None))
