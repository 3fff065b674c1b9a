"""The files of a run folder: read, compared with the seal and with each other, and where one differs, in which row."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from evaluator.protocol import acting_steps
from evaluator.run.actions import NOT_ASKED, POLICY_ERROR, actions_of, decode_actions, encode_actions
from evaluator.run.counts import Counts, count_rows, same_numbers, summary_numbers, unfinished
from evaluator.run.header import RUN_FILE, encode_header
from evaluator.run.plan import Plan, scenario_list
from evaluator.run.seal import (
    ACTIONS_FILE,
    SUMMARY_FILE,
    old_seal_problems,
    results_name,
    seal_of,
    sealed_names,
)
from evaluator.run.summary import read_summary, summarise
from evaluator.run.tables import read_results
from evaluator.statistics import wilson
from rema_data.errors import InputError, RemaError
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
    # (episodes, steps): ``actions.bin``, or the actions of the table where there is none that can be read
    actions: npt.NDArray[np.uint16] | None = None
    unfinished: int | None = None  # counted with the scenario list; None where that is not here
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


def read_files(folder: Path, header: dict[str, Any], payload: bytes) -> RunFiles:
    """Read the files of a run, and compare them with the seal where there is one, and with each other.

    An InputError says that ``summary.json`` is as it was written, but not the summary of a run.
    """
    identity, results = header["identity"], results_name(header)
    steps = acting_steps(identity["task"], identity["protocol"])
    names = [*sealed_names(header), SUMMARY_FILE] if "seal" in header else [results, SUMMARY_FILE]
    files = {name: _read(folder / name) for name in names}
    found = [Finding(name, "", "is missing") for name, content in files.items() if content is None]
    content = files[results]
    table, stored, problems = (None, None, []) if content is None else read_results(content, identity["task"])
    found += [Finding(results, where, detail) for where, detail in problems]
    if table is not None and table.num_rows != header["episodes"]:
        detail = f"has {table.num_rows} rows, the run has {header['episodes']} episodes"
        found.append(Finding(results, "", detail))
    shown = actions_of(table, steps) if table is not None and table.num_rows == header["episodes"] else None
    actions, wrong = _actions(header, files, table, shown) if "seal" in header else (shown, [])
    found += wrong
    if "seal" in header:
        found = [*_seal_findings(header, payload, files, bool(found)), *found]
    summary = None
    if (content := files[SUMMARY_FILE]) is not None:
        try:
            summary = read_summary(content, folder / SUMMARY_FILE)
        except InputError as error:
            if "seal" not in header:
                raise
            found.append(Finding(SUMMARY_FILE, "", f"cannot be read: {error.message}"))
    counts = None if table is None else count_rows(table, steps)
    left = None if table is None or counts is None else _unfinished(header, table)
    if summary is not None:
        found += _contradictions(header, summary, counts, table, left)
    return RunFiles(header, payload, table, stored, counts, actions, left, summary, tuple(found))


def _read(path: Path) -> bytes | None:
    with storage_errors(path):
        return path.read_bytes() if path.is_file() else None


def _unfinished(header: Mapping[str, Any], table: pa.Table) -> int | None:
    """Episodes without a result; None where the list of the run, which says whether they can have one, is not here."""
    identity = header["identity"]
    try:
        scenarios = scenario_list(header).scenarios[: table.num_rows]
    except RemaError:
        return None
    return unfinished(Plan(scenarios, identity["task"], identity["protocol"]), table)


def _seal_findings(
    header: dict[str, Any], payload: bytes, files: Mapping[str, bytes | None], known: bool
) -> Iterator[Finding]:
    """What the seal shows; one that is over all files at once is silent where it is ``known`` which of them changed."""
    if isinstance(header["seal"], dict):
        for name, part in old_seal_problems(header, files):
            yield Finding(name or RUN_FILE, part, "is not what was sealed")
    elif not known and not _is_sealed(header, files):
        yield Finding(f"{' or '.join(sealed_names(header))} or {RUN_FILE}", "", "changed since the run was sealed")
    if payload != encode_header(header).encode():
        yield Finding(RUN_FILE, "", "is not laid out as it was written")


def _contradictions(
    header: dict[str, Any],
    summary: dict[str, Any],
    counts: Counts | None,
    table: pa.Table | None,
    left: int | None,
) -> Iterator[Finding]:
    """Fields of ``summary.json`` that do not follow from the rows, or from ``run.json``."""
    numbers: dict[str, Any] = {}
    if counts is not None and table is not None:
        numbers = summary_numbers(counts, table) | ({} if left is None else {"unfinished": left})
    if "end" in header and counts is not None and table is not None:
        given = summary.get("unfinished", 0) if left is None else left
        expected = json.loads(json.dumps(summarise(header, counts, table, given)))
        unknown = sorted(summary.keys() - expected.keys())
        yield from (Finding(SUMMARY_FILE, name, "is not a field of a summary") for name in unknown)
    else:
        identity, policy = header["identity"], header["policy"]
        expected = {name: identity[name] for name in _IDENTITY} | numbers
        expected |= {"policy": policy.get("name"), "privileged": policy.get("privileged")}
        if header["format"] == 1 and counts is not None and counts.eligible:
            expected["ci95"] = list(wilson(counts.successes, counts.eligible))
    for name, value in expected.items():
        if not same_numbers(summary.get(name), value):
            source = results_name(header) if name in numbers else RUN_FILE
            detail = f"says {shortened(summary.get(name))}, {source} gives {shortened(value)}"
            yield Finding(SUMMARY_FILE, name, detail)


def shortened(value: Any) -> str:
    """A value as JSON, cut where it is long."""
    text = json.dumps(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def _actions(
    header: dict[str, Any],
    files: Mapping[str, bytes | None],
    table: pa.Table | None,
    shown: npt.NDArray[np.uint16] | None,
) -> tuple[npt.NDArray[np.uint16] | None, list[Finding]]:
    """The actions as they were sealed, and where log and table differ, which of them is to blame."""
    identity, results = header["identity"], results_name(header)
    steps, payload = acting_steps(identity["task"], identity["protocol"]), files[ACTIONS_FILE]
    if payload is None:
        return shown, []
    log = decode_actions(payload, header["episodes"], len(steps))
    if log is None:
        return shown, [Finding(ACTIONS_FILE, "", f"has {len(payload)} bytes, not two for every action")]
    if shown is None or np.array_equal(log, shown):
        return log, []
    pair = [(results, shown), (ACTIONS_FILE, log)]
    if _is_sealed(header, {**files, ACTIONS_FILE: encode_actions(shown)}):
        pair.reverse()  # the table is as it was sealed
    (file, blamed), (beside, witness) = pair
    found = []
    for row, column in np.argwhere(log != shown).tolist():
        said, other = _named(int(blamed[row, column])), _named(int(witness[row, column]))
        where = f"{row_name(table, row)}, step {steps[column]}"
        found.append(Finding(file, where, f"says {said}, {beside} says {other}"))
    return witness, found


def _is_sealed(header: dict[str, Any], files: Mapping[str, bytes | None]) -> bool:
    """Whether the seal is over this table and this log."""
    sealed = {name: content for name in sealed_names(header) if (content := files[name]) is not None}
    if isinstance(header["seal"], dict):
        return not any(name for name, _ in old_seal_problems(header, sealed))
    return len(sealed) == len(sealed_names(header)) and seal_of(header, sealed) == header["seal"]


def _named(action: int) -> str:
    return {POLICY_ERROR: "policy error", NOT_ASKED: "not asked"}.get(action, f"action {action}")
