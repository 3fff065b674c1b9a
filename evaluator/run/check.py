"""Does a run folder still hold what was sealed? Every byte of its sealed files, and where one differs, which row."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from evaluator.run.actions import NOT_ASKED, POLICY_ERROR, actions_of, decode_actions
from evaluator.run.header import RUN_FILE, encode_header, read_header, resume_command
from evaluator.run.lock import being_written
from evaluator.run.merkle import HASH_BYTES, merkle_root
from evaluator.run.rows import row_leaves
from evaluator.run.seal import (
    ACTIONS_FILE,
    EPISODES_FILE,
    LEAVES_FILE,
    SUMMARY_FILE,
    changed_parts,
    seal_is_whole,
)
from evaluator.run.tables import episodes_schema
from rema_data.errors import MissingFileError
from rema_data.schema import TASKS
from rema_data.storage import storage_errors

__all__ = ["Evidence", "Finding", "read_evidence", "row_name"]


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that is not as it was sealed, or not true.

    Attributes
    ----------
    file : str
        Name in the run folder.
    where : str
        Row, entry or column; empty where the whole file is meant.
    detail : str
    """

    file: str
    where: str
    detail: str


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """A sealed run as it lies in its folder.

    Attributes
    ----------
    folder : Path
    header : dict
        Content of ``run.json``.
    payload : bytes
        Of ``run.json``.
    table : pyarrow.Table or None
        ``episodes.parquet``; None where it cannot be read.
    actions : uint16 (episodes, steps) or None
        ``actions.bin``; the table's own actions where that is not as sealed, None where neither can be read.
    summary : dict or None
        ``summary.json``.
    findings : tuple of Finding
        Empty where everything is as it was sealed.
    """

    folder: Path
    header: dict[str, Any]
    payload: bytes
    table: pa.Table | None
    actions: npt.NDArray[np.uint16] | None
    summary: dict[str, Any] | None
    findings: tuple[Finding, ...]

    @property
    def trusted(self) -> bool:
        """Whether ``run.json`` is as it was sealed, so that what it says can be checked."""
        return not any(finding.file == RUN_FILE for finding in self.findings)

    @property
    def seal(self) -> dict[str, Any]:
        """The seal in ``run.json``."""
        seal: dict[str, Any] = self.header["seal"]
        return seal


def row_name(table: pa.Table | None, row: int) -> str:
    """How a row is called in a report: its number, and its scenario where the table tells it."""
    if table is None or not 0 <= row < table.num_rows or "scenario" not in table.schema.names:
        return f"row {row}"
    return f"row {row} ({table.column('scenario')[row].as_py()})"


def read_evidence(folder: Path) -> Evidence:
    """Read a finished run and compare it with its seal.

    Raises
    ------
    MissingFileError
        There is no run, or it is not sealed: not finished, or made before there were seals.
    IntegrityError
        ``run.json`` is none.
    """
    header, payload = read_header(folder)
    if "seal" not in header and being_written(folder):
        raise MissingFileError(
            f"{folder} is not sealed yet: a process is writing in it", hint="wait for its end", path=str(folder)
        )
    if "seal" not in header:
        raise MissingFileError(
            f"{folder} is not sealed: the run was interrupted, or made by a version of rema without seals",
            hint="run the command that made it again (with its --checkpoint, if it had one): it goes on where it "
            f"stopped and writes what is missing\n{resume_command(header, folder)}",
            path=str(folder),
        )
    found = list(_header_findings(header, payload))
    if not (seal_is_whole(header["seal"]) and _says_what(header)):
        found = found or [Finding(RUN_FILE, "identity", "does not say what was evaluated")]
        return Evidence(folder, header, payload, None, None, None, tuple(found))
    files = {name: _read(folder / name) for name in header["seal"]["files"]}
    changed = {name for name, content in files.items() if not _as_sealed(header, name, content)}
    found += [Finding(name, "", "is missing") for name, content in files.items() if content is None]
    table = None
    if (content := files[EPISODES_FILE]) is not None:
        table, problems = _table(header["identity"]["task"], content)
        found += problems
    found += _row_findings(header, table, files[LEAVES_FILE], changed)
    log, problems = _actions(header, table, files[ACTIONS_FILE], changed)
    found += problems
    summary, problems = _summary(files[SUMMARY_FILE], SUMMARY_FILE in changed)
    found += problems
    return Evidence(folder, header, payload, table, log, summary, tuple(found))


def _read(path: Path) -> bytes | None:
    with storage_errors(path):
        return path.read_bytes() if path.is_file() else None


def _as_sealed(header: dict[str, Any], name: str, content: bytes | None) -> bool:
    return content is not None and hashlib.sha256(content).hexdigest() == header["seal"]["files"][name]


def _says_what(header: dict[str, Any]) -> bool:
    """Whether the identity names a task, a protocol and its steps."""
    identity, steps = header["identity"], header["seal"]["steps"]
    count = len(TASKS.get(identity.get("task"), ()))
    played = {"conditional": [count - 1], "end-to-end": list(range(count))}.get(identity.get("protocol"))
    return bool(count) and steps == played and isinstance(identity.get("split"), str)


def _header_findings(header: dict[str, Any], payload: bytes) -> Iterator[Finding]:
    if not seal_is_whole(header["seal"]):
        yield Finding(RUN_FILE, "seal", "is not the seal that was made")
        return
    for name in changed_parts(header):
        yield Finding(RUN_FILE, name, "is not what was sealed")
    if payload != encode_header(header).encode():
        yield Finding(RUN_FILE, "", "is not laid out as it was written")


def _table(task: str, payload: bytes) -> tuple[pa.Table | None, list[Finding]]:
    """The table of episodes, or which of its columns cannot be read."""
    schema = episodes_schema(task)
    broken = (pa.ArrowException, OSError, ValueError)
    try:
        file = pq.ParquetFile(io.BytesIO(payload))
        names = list(file.schema_arrow.names)
    except broken as error:
        return None, [Finding(EPISODES_FILE, "", f"cannot be read: {_first_line(error)}")]
    if names != schema.names:
        return None, [Finding(EPISODES_FILE, "", f"does not have the columns of {task} episodes")]
    columns, found = [], []
    for name in names:
        try:
            column = file.read(columns=[name]).column(0)
            column.validate(full=True)
            column.to_pylist()
        except broken as error:
            found.append(Finding(EPISODES_FILE, f"column {name}, all rows", f"cannot be read: {_first_line(error)}"))
        else:
            columns.append(column)
    if found:
        return None, found
    if len({len(column) for column in columns}) != 1 or [column.type for column in columns] != schema.types:
        return None, [Finding(EPISODES_FILE, "", f"does not have the columns of {task} episodes")]
    return pa.table(columns, names=names), []


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def _row_findings(
    header: dict[str, Any], table: pa.Table | None, stored: bytes | None, changed: set[str]
) -> Iterator[Finding]:
    """Rows and leaves that are not those under the root."""
    root, count = header["seal"]["merkle_root"], header["episodes"]
    leaves = _split(stored) if stored is not None else []
    rows = row_leaves(table) if table is not None else None
    if LEAVES_FILE in changed and stored is not None:
        places = _differing(rows, leaves) if rows is not None and merkle_root(rows).hex() == root else []
        yield from _changed(LEAVES_FILE, table, places, "is not the hash of this row")
    if rows is None or table is None:
        return
    if len(rows) != count:
        yield Finding(EPISODES_FILE, "", f"has {len(rows)} rows, the run has {count} episodes")
    elif merkle_root(rows).hex() != root:
        known = merkle_root(leaves).hex() == root
        yield from _changed(EPISODES_FILE, table, _differing(rows, leaves) if known else [], "is not what was sealed")
    elif EPISODES_FILE in changed:
        yield Finding(EPISODES_FILE, "", "has other bytes than were sealed, though all rows are the same")


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
    steps = header["seal"]["steps"]
    shown = actions_of(table, steps) if table is not None and table.num_rows == header["episodes"] else None
    if payload is None:
        return shown, []
    log = decode_actions(payload, header["episodes"], len(steps))
    if log is None:
        return shown, [Finding(ACTIONS_FILE, "", f"has {len(payload)} bytes, not two for every action")]
    found = []
    if shown is not None:
        pair = [(ACTIONS_FILE, log), (EPISODES_FILE, shown)]
        if changed & {ACTIONS_FILE, EPISODES_FILE} == {EPISODES_FILE}:
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


def _summary(payload: bytes | None, changed: bool) -> tuple[dict[str, Any] | None, list[Finding]]:
    if payload is None:
        return None, []
    found = [Finding(SUMMARY_FILE, "", "is not what was sealed")] if changed else []
    try:
        content = json.loads(payload.decode("utf-8"))
        if not isinstance(content, dict):
            raise ValueError("not an object")
    except (ValueError, RecursionError) as error:
        return None, [*found, Finding(SUMMARY_FILE, "", f"cannot be read: {_first_line(error)}")]
    return content, found
