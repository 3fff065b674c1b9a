"""The files of a run folder: read, compared with the seal and with each other, and where one differs, in which row."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from evaluator.protocol import acting_steps
from evaluator.run.actions import NOT_ASKED, POLICY_ERROR, actions_of, decode_actions
from evaluator.run.counts import Counts, count_rows, same_numbers, summary_numbers
from evaluator.run.header import RUN_FILE, encode_header
from evaluator.run.merkle import HASH_BYTES, merkle_root
from evaluator.run.rows import row_leaves
from evaluator.run.seal import ACTIONS_FILE, LEAVES_FILE, SUMMARY_FILE, changed_parts, results_name, seal_is_whole
from evaluator.run.summary import read_summary
from evaluator.run.tables import read_results
from evaluator.statistics import wilson
from rema_data.errors import InputError
from rema_data.storage import storage_errors

__all__ = ["Finding", "RunFiles", "read_files", "row_name", "shortened"]

_SHOWN = 80
"""Characters of a value in a finding."""
_IDENTITY = ("task", "split", "protocol", "policy_digest", "protocol_hash", "scenarios_hash", "fingerprint")


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that is not as it was sealed, or not true."""

    file: str  # name in the run folder
    where: str  # row, field or column; empty for the whole file
    detail: str  # what is wrong

    def __str__(self) -> str:
        return " ".join(part for part in (self.file, self.where, self.detail) if part)


@dataclass(frozen=True, slots=True, eq=False)
class RunFiles:
    """A run as it lies in its folder. What cannot be read is None, and a finding says why."""

    header: dict[str, Any]  # content of ``run.json``
    payload: bytes  # its bytes
    table: pa.Table | None = None  # the results table
    stored: pa.Table | None = None  # the same without the columns that are newer than the file
    counts: Counts | None = None  # of the table
    # (episodes, steps) of ``actions.bin``, or the table's where that changed; only if rows are compared
    actions: npt.NDArray[np.uint16] | None = None
    summary: dict[str, Any] | None = None
    findings: tuple[Finding, ...] = ()  # empty where everything is as it was sealed, and the files agree

    @property
    def sealed(self) -> bool:
        """Whether there is a seal."""
        return "seal" in self.header


def row_name(table: pa.Table | None, row: int) -> str:
    """How a row is called in a report: its number, and its scenario where the table tells it."""
    if table is None or not 0 <= row < table.num_rows:
        return f"row {row}"
    return f"row {row} ({table.column('scenario')[row].as_py()})"


def read_files(folder: Path, header: dict[str, Any], payload: bytes, *, every_row: bool) -> RunFiles:
    """Read the files of a run, and compare them with the seal where there is one.

    ``every_row`` compares rows and actions one by one even where every file has the bytes that were sealed. An
    InputError says that ``summary.json`` is as it was written, but not the summary of a run.
    """
    found = list(_header_findings(header, payload)) if "seal" in header else []
    identity = header["identity"]
    steps = acting_steps(identity["task"], identity["protocol"])
    if "seal" in header and (not seal_is_whole(header) or header["seal"]["steps"] != list(steps)):
        found = found or [Finding(RUN_FILE, "seal", "is of other steps than the protocol's")]
        return RunFiles(header, payload, findings=tuple(found))
    results = results_name(header)
    sealed = header["seal"]["files"] if "seal" in header else {}
    files = {name: _read(folder / name) for name in sealed or (results, SUMMARY_FILE)}
    found += [Finding(name, "", "is missing") for name, content in files.items() if content is None]
    changed = {name for name in sealed if not _has_digest(files[name], sealed[name])}
    content = files[results]
    table, stored, problems = (None, None, []) if content is None else read_results(content, identity["task"])
    actions = None
    if sealed and (every_row or changed):
        found += _row_findings(header, stored, files[LEAVES_FILE], changed)
        actions, wrong = _actions(header, table, files[ACTIONS_FILE], changed)
        found += wrong
    found += [Finding(results, where, detail) for where, detail in problems]
    if table is not None and table.num_rows != header["episodes"]:
        detail = f"has {table.num_rows} rows, the run has {header['episodes']} episodes"
        found.append(Finding(results, "", detail))
    summary = None
    if (content := files[SUMMARY_FILE]) is not None:
        if SUMMARY_FILE in changed:
            found.append(Finding(SUMMARY_FILE, "", "is not what was sealed"))
        try:
            summary = read_summary(content, folder / SUMMARY_FILE)
        except InputError as error:
            if not found:
                raise
            found.append(Finding(SUMMARY_FILE, "", f"cannot be read: {error.message}"))
    counts = None if table is None else count_rows(table, steps)
    if summary is not None:
        found += _contradictions(header, summary, counts, table)
    return RunFiles(header, payload, table, stored, counts, actions, summary, tuple(found))


def _read(path: Path) -> bytes | None:
    with storage_errors(path):
        return path.read_bytes() if path.is_file() else None


def _has_digest(content: bytes | None, digest: str) -> bool:
    return content is not None and hashlib.sha256(content).hexdigest() == digest


def _header_findings(header: dict[str, Any], payload: bytes) -> Iterator[Finding]:
    if not seal_is_whole(header):
        yield Finding(RUN_FILE, "seal", "is not the seal that was made")
        return
    for name in changed_parts(header):
        yield Finding(RUN_FILE, name, "is not what was sealed")
    if payload != encode_header(header).encode():
        yield Finding(RUN_FILE, "", "is not laid out as it was written")


def _contradictions(
    header: dict[str, Any], summary: dict[str, Any], counts: Counts | None, table: pa.Table | None
) -> Iterator[Finding]:
    """Fields of ``summary.json`` that do not follow from the rows, or from ``run.json``."""
    identity, policy = header["identity"], header["policy"]
    expected = {
        **{name: identity[name] for name in _IDENTITY},
        "policy": policy.get("name"),
        "privileged": policy.get("privileged"),
    }
    if "seal" in header:
        expected["merkle_root"] = header["seal"]["merkle_root"]
    sources = dict.fromkeys(expected, RUN_FILE)
    if counts is not None and table is not None:
        numbers = summary_numbers(counts, table)
        if header["format"] == 1 and counts.eligible:
            numbers["ci95"] = list(wilson(counts.successes, counts.eligible))
        expected |= numbers
        sources |= dict.fromkeys(numbers, results_name(header))
    for name, value in expected.items():
        if not same_numbers(summary.get(name), value):
            detail = f"says {shortened(summary.get(name))}, {sources[name]} gives {shortened(value)}"
            yield Finding(SUMMARY_FILE, name, detail)


def shortened(value: Any) -> str:
    """A value as JSON, cut where it is long."""
    text = json.dumps(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def _row_findings(
    header: dict[str, Any], table: pa.Table | None, stored: bytes | None, changed: set[str]
) -> Iterator[Finding]:
    """Rows and leaves that are not those under the root; ``table`` as it is stored."""
    root, count, results = header["seal"]["merkle_root"], header["episodes"], results_name(header)
    leaves = _split(stored) if stored is not None else []
    rows = row_leaves(table) if table is not None else None
    if LEAVES_FILE in changed and stored is not None:
        places = _differing(rows, leaves) if rows is not None and merkle_root(rows).hex() == root else []
        yield from _changed(LEAVES_FILE, table, places, "is not the hash of this row")
    if rows is None or table is None or len(rows) != count:
        return
    if merkle_root(rows).hex() != root:
        known = merkle_root(leaves).hex() == root
        yield from _changed(results, table, _differing(rows, leaves) if known else [], "is not what was sealed")
    elif results in changed:
        yield Finding(results, "", "has other bytes than were sealed, though all rows are the same")


def _split(stored: bytes) -> list[bytes]:
    return [stored[start : start + HASH_BYTES] for start in range(0, len(stored), HASH_BYTES)]


def _differing(some: Sequence[bytes], others: Sequence[bytes]) -> list[int]:
    common = [n for n, (one, other) in enumerate(zip(some, others, strict=False)) if one != other]
    return common + list(range(min(len(some), len(others)), max(len(some), len(others))))


def _changed(file: str, table: pa.Table | None, rows: Iterable[int], detail: str) -> Iterator[Finding]:
    """One finding a row, or one about the file where no row can be blamed."""
    named = [Finding(file, row_name(table, row), detail) for row in rows]
    yield from named or [Finding(file, "", "is not what was sealed")]


def _actions(
    header: dict[str, Any], table: pa.Table | None, payload: bytes | None, changed: set[str]
) -> tuple[npt.NDArray[np.uint16] | None, list[Finding]]:
    steps, results = header["seal"]["steps"], results_name(header)
    shown = actions_of(table, steps) if table is not None and table.num_rows == header["episodes"] else None
    if payload is None:
        return shown, []
    log = decode_actions(payload, header["episodes"], len(steps))
    if log is None:
        return shown, [Finding(ACTIONS_FILE, "", f"has {len(payload)} bytes, not two for every action")]
    found = []
    if shown is not None:
        pair = [(ACTIONS_FILE, log), (results, shown)]
        if changed & {ACTIONS_FILE, results} == {results}:
            pair.reverse()  # the other one is as it was sealed: this one is to blame
        (file, blamed), (beside, witness) = pair
        for row, column in np.argwhere(log != shown).tolist():
            said, other = _named(int(blamed[row, column])), _named(int(witness[row, column]))
            where = f"{row_name(table, row)}, step {steps[column]}"
            found.append(Finding(file, where, f"says {said}, {beside} says {other}"))
    if ACTIONS_FILE in changed:
        return shown, found or [Finding(ACTIONS_FILE, "", "is not what was sealed")]
    return log, found


def _named(action: int) -> str:
    return {POLICY_ERROR: "policy error", NOT_ASKED: "not asked"}.get(action, f"action {action}")
