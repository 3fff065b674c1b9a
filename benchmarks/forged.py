"""The forgeries of ``forgeries.py``: each makes runs or entries from an honest run, and seals what it changes."""

from __future__ import annotations

import base64
import dataclasses
import json
import shutil
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from evaluator.run.actions import NOT_ASKED, Actions, actions_of, encode_actions
from evaluator.run.counts import count_rows
from evaluator.run.derived import derived_of
from evaluator.run.entry import encode, seal
from evaluator.run.header import RUN_FILE, encode_header
from evaluator.run.reading import read_run
from evaluator.run.seal import ACTIONS_FILE, RESULTS_FILE, SUMMARY_FILE, seal_of
from evaluator.run.summary import summarise
from evaluator.run.tables import to_parquet
from rema_data import grid

__all__ = ["FORGERIES", "Forger"]

Forge = Callable[["Forger"], list[Path]]
FORGERIES: dict[str, Forge] = {}
"""By what the forger does."""
CLONES = 8


def forgery(what: str) -> Callable[[Forge], Forge]:
    """Register a forgery."""

    def keep(forge: Forge) -> Forge:
        FORGERIES[what] = forge
        return forge

    return keep


@dataclass(frozen=True)
class Forger:
    """What a forger has: an honest run, its entry, and a folder of his own."""

    run: Path
    folder: Path

    def copy(self, name: str = "forged") -> Path:
        """A copy of the honest run under another policy's name."""
        made = Path(shutil.copytree(self.run, self.folder / name, ignore=shutil.ignore_patterns("records", ".lock")))
        self.seal_again(made, policy={"name": name, "file": f"{name}.py"}, identity={"policy_digest": "f" * 64})
        return made

    def seal_again(
        self,
        folder: Path,
        table: pa.Table | None = None,
        *,
        policy: dict[str, Any] | None = None,
        identity: dict[str, Any] | None = None,
        header: dict[str, Any] | None = None,
        summary: dict[str, Any] | None = None,
        actions: Actions | None = None,
    ) -> None:
        """Change a run, let everything follow from the change, and seal it as the evaluator does."""
        content = json.loads((folder / RUN_FILE).read_text())
        content.pop("seal", None)
        content.update(header or {})
        content["policy"].update(policy or {})
        content["identity"].update(identity or {})
        rows = pq.read_table(folder / RESULTS_FILE) if table is None else table
        steps = read_run(self.run).steps
        log = actions_of(rows, steps) if actions is None else actions
        files = {RESULTS_FILE: to_parquet(rows), ACTIONS_FILE: encode_actions(log)}
        content["seal"] = seal_of(content, files)
        told = {**summarise(content, count_rows(rows, steps), rows, 0), **(summary or {})}
        texts = {RUN_FILE: encode_header(content), SUMMARY_FILE: json.dumps(told, indent=2) + "\n"}
        for name, data in {**files, **{name: text.encode() for name, text in texts.items()}}.items():
            (folder / name).write_bytes(data)

    def entry(self, name: str = "forged", **changes: Any) -> Path:
        """An entry of the honest run's actions, or of others, under another policy's name."""
        path = self.folder / f"{name}.json"
        run = read_run(self.run)
        provenance = dataclasses.replace(run.provenance, policy_digest="f" * 64)
        fields: dict[str, Any] = {"kind_of_policy": "submitted", "provenance": provenance, "recorded": run.actions}
        path.write_bytes(encode(dataclasses.replace(run, policy=name, files=None, **{**fields, **changes})))
        return path

    def edited(self, edit: Callable[[dict[str, Any]], Any]) -> Path:
        """An entry with changed content and a new seal."""
        path = self.entry()
        content = json.loads(path.read_text())
        edit(content)
        content["sha256"] = seal(content)
        path.write_text(json.dumps(content))
        return path


def with_columns(table: pa.Table, rows: np.ndarray, **values: Any) -> pa.Table:
    """The table with values in some rows."""
    for name, value in values.items():
        column = table[name].to_pylist()
        for row in rows.tolist():
            column[row] = value
        field = table.schema.field(name)
        table = table.set_column(table.schema.get_field_index(name), field, pa.array(column, field.type))
    return table


def successes(table: pa.Table, rows: np.ndarray, steps: tuple[int, ...]) -> pa.Table:
    """The table with rows that say that they succeeded."""
    values: dict[str, Any] = {"success": True, "failure": None, "failed_step": None}
    values |= {f"step{step}_{name}": value for step in steps for name, value in (("success", True), ("failure", None))}
    return with_columns(table, rows, **values)


def failed_rows(table: pa.Table) -> np.ndarray:
    """Rows of the failed episodes."""
    return np.flatnonzero([success is False for success in table["success"].to_pylist()])


@forgery("nothing simulated: every episode a success, with actions of its own")
def _invented(forger: Forger) -> list[Path]:
    folder, steps = forger.copy(), read_run(forger.run).steps
    table = pq.read_table(folder / RESULTS_FILE)
    moved = np.flatnonzero(np.ones(table.num_rows, bool))
    for step in steps:
        action = int(grid.encode(31, 31, 3))
        x_m, y_m, yaw = (float(part) for part in grid.to_world(action))
        pose = {f"step{step}_{name}": value for name, value in (("x_m", x_m), ("y_m", y_m), ("theta_rad", yaw))}
        table = with_columns(table, moved, **{f"step{step}_action": action, **pose})
    forger.seal_again(folder, successes(table, moved, steps))
    return [folder]


@forgery("nothing simulated: every episode a success, with the actions of somebody else")
def _claimed(forger: Forger) -> list[Path]:
    folder, run = forger.copy(), read_run(forger.run)
    forger.seal_again(folder, successes(run.table, np.arange(run.table.num_rows), run.steps))
    return [folder]


@forgery("a few failures turned into successes")
def _a_few(forger: Forger) -> list[Path]:
    folder, run = forger.copy(), read_run(forger.run)
    forger.seal_again(folder, successes(run.table, failed_rows(run.table)[:3], run.steps))
    return [folder]


@forgery("the column of successes changed, not the steps")
def _column(forger: Forger) -> list[Path]:
    folder, run = forger.copy(), read_run(forger.run)
    rows = failed_rows(run.table)
    forger.seal_again(folder, with_columns(run.table, rows, success=True, failure=None, failed_step=None))
    return [folder]


@forgery("an edited summary")
def _summary(forger: Forger) -> list[Path]:
    folder = forger.copy()
    forger.seal_again(folder, summary={"success_rate": 0.999, "successes": 999_999, "ci95": [0.99, 1.0]})
    return [folder]


@forgery("failed rows emptied, with `unfinished: 0`")
def _missing(forger: Forger) -> list[Path]:
    folder, run = forger.copy(), read_run(forger.run)
    rows = failed_rows(run.table)
    values: dict[str, Any] = {"success": None, "failure": None, "failed_step": None}
    values |= {f"step{step}_{name}": None for step in run.steps for name in ("success", "failure", "action")}
    forger.seal_again(folder, with_columns(run.table, rows, **values), summary={"unfinished": 0})
    return [folder]


@forgery("failed rows declared lost to the infrastructure")
def _lost(forger: Forger) -> list[Path]:
    folder, run = forger.copy(), read_run(forger.run)
    values: dict[str, Any] = {"success": None, "failure": None, "failed_step": None, "infra_error": "died"}
    values |= {f"step{step}_{name}": None for step in run.steps for name in ("success", "failure")}
    forger.seal_again(folder, with_columns(run.table, failed_rows(run.table), **values))
    return [folder]


@forgery("a denominator of its own: the successes alone")
def _denominator(forger: Forger) -> list[Path]:
    folder, run = forger.copy(), read_run(forger.run)
    kept = np.flatnonzero(run.outcomes.success)
    table = with_columns(run.table.take(kept), np.arange(0))
    index = pa.array(range(len(kept)), table.schema.field("index").type)
    table = table.set_column(table.schema.get_field_index("index"), table.schema.field("index"), index)
    forger.seal_again(folder, table, header={"episodes": len(kept)})
    return [folder]


@forgery("a denominator of its own: a first part of the list")
def _short(forger: Forger) -> list[Path]:
    folder, run = forger.copy(), read_run(forger.run)
    part = run.table.slice(0, run.table.num_rows // 3)
    forger.seal_again(folder, part, header={"episodes": part.num_rows})
    return [folder]


@forgery("easy scenarios played several times")
def _easy(forger: Forger) -> list[Path]:
    folder, run = forger.copy(), read_run(forger.run)
    easy = np.flatnonzero(run.outcomes.success)
    rows = np.where(run.outcomes.success, np.arange(run.table.num_rows), easy[0])
    table = run.table.take(rows)
    index = pa.array(range(table.num_rows), table.schema.field("index").type)
    table = table.set_column(table.schema.get_field_index("index"), table.schema.field("index"), index)
    table = table.set_column(0, table.schema.field(0), run.table.column(0))
    forger.seal_again(folder, table)
    return [folder]


@forgery("actions that the protocol does not allow")
def _invalid(forger: Forger) -> list[Path]:
    folder, run = forger.copy(), read_run(forger.run)
    rows = failed_rows(run.table)[:2]
    table = successes(run.table, rows, run.steps)
    forger.seal_again(folder, with_columns(table, rows, **{f"step{run.steps[-1]}_action": 5}))
    return [folder]


@forgery("another action log than the table's")
def _log(forger: Forger) -> list[Path]:
    folder, run = forger.copy(), read_run(forger.run)
    forger.seal_again(folder, actions=np.roll(run.actions, 1, axis=0))
    return [folder]


@forgery("the name of an installed policy")
def _name(forger: Forger) -> list[Path]:
    folder = forger.copy("random")
    forger.seal_again(folder, policy={"name": "random"})
    return [folder, forger.entry("tae-joint", kind_of_policy="learned")]


@forgery("a rule of its own: another protocol hash")
def _rule(forger: Forger) -> list[Path]:
    folder = forger.copy()
    forger.seal_again(folder, identity={"protocol_hash": "0" * 64})
    provenance = dataclasses.replace(read_run(forger.run).provenance, protocol_hash="0" * 64)
    return [folder, forger.entry("other", provenance=provenance)]


@forgery("a list of its own")
def _list(forger: Forger) -> list[Path]:
    folder = forger.copy()
    forger.seal_again(folder, identity={"scenarios_hash": "0" * 64})
    return [folder, forger.edited(lambda entry: entry["marks"].update(scenarios_hash="0" * 64))]


@forgery("an entry that claims a rate")
def _rate(forger: Forger) -> list[Path]:
    return [forger.edited(lambda entry: entry.update(counts={"successes": 10_000, "eligible": 10_000}))]


@forgery("an entry with a tag of its own")
def _tag(forger: Forger) -> list[Path]:
    return [
        forger.entry("learned-one", kind_of_policy="learned"),
        forger.edited(lambda e: e["policy"].update(kind="best")),
    ]


@forgery("an entry of another size: the failures left out")
def _left_out(forger: Forger) -> list[Path]:
    run = read_run(forger.run)
    kept = run.actions[run.outcomes.success]
    packed = base64.b64encode(zlib.compress(encode_actions(kept))).decode()
    return [forger.edited(lambda entry: entry.update(actions=packed))]


@forgery("an entry that answers only what it can solve")
def _unanswered(forger: Forger) -> list[Path]:
    run = read_run(forger.run)
    actions = np.where(run.outcomes.success[:, None], run.actions, np.uint16(NOT_ASKED))
    return [forger.entry(recorded=actions)]


@forgery("an entry of gigabytes")
def _bomb(forger: Forger) -> list[Path]:
    return [forger.edited(lambda e: e.update(actions=base64.b64encode(zlib.compress(bytes(1 << 26), 9)).decode()))]


@forgery("an old entry that claims 100 %")
def _old(forger: Forger) -> list[Path]:
    run = read_run(forger.run)
    count, mark = run.table.num_rows, run.provenance
    ones = base64.b64encode(np.packbits(np.ones(count, bool)).tobytes()).decode()
    funnel = [{"step": step, "attempted": count, "succeeded": count} for step in run.steps]
    content: dict[str, Any] = {
        "format": 1,
        "policy": {"name": "forged", "privileged": False, "link": ""},
        **{"task": run.task, "split": run.split, "protocol": run.protocol},
        "counts": {
            **{"episodes": count, "eligible": count, "successes": count, "failures": {}, "policy_errors": 0},
            **{"infra_errors": 0, "funnel": funnel},
        },
        "marks": {
            **{"policy_digest": "f" * 64, "protocol_hash": mark.protocol_hash, "scenarios_hash": mark.scenarios_hash},
            "fingerprint": dict(mark.fingerprint),
        },
        "provenance": {},
        "audit": {"actions": 100, "action_flips": 0, "outcomes": 100, "outcome_flips": 0},
        "evidence": {"merkle_root": "0" * 64, "seal": "0" * 64},
        "outcomes": {"eligible": ones, "success": ones},
    }
    path = forger.folder / "forged.json"
    path.write_text(json.dumps({**content, "sha256": seal(content)}))
    return [path]


@forgery("a verification record of its own, beside its entry")
def _record(forger: Forger) -> list[Path]:
    run = read_run(forger.run)
    actions = run.actions.copy()
    actions[::20] = int(grid.encode(30, 30, 2))
    path = forger.entry(recorded=actions)
    found = derived_of(
        successes(run.table, np.arange(run.table.num_rows), run.steps), run.steps, run.provenance.fingerprint
    )
    record = {"format": 1, "number": 1, "entry": json.loads(path.read_text())["sha256"], "commit": None}
    record |= {"fingerprint": dict(found.fingerprint), "rows": found.pack()}
    (path.parent / "verified").mkdir()
    (path.parent / "verified" / path.name).write_text(json.dumps(record))
    return [path]


@forgery("a copied entry under another name")
def _copied(forger: Forger) -> list[Path]:
    return [forger.entry("aaa-first")]


@forgery("eight clones")
def _clones(forger: Forger) -> list[Path]:
    return [forger.entry(f"clone-{number}") for number in range(CLONES)]


@forgery("eight clones, each with a changed action")
def _near_clones(forger: Forger) -> list[Path]:
    run, paths = read_run(forger.run), []
    for number in range(CLONES):
        actions = run.actions.copy()
        actions[failed_rows(run.table)[number], -1] = int(grid.encode(20 + number, 20, 1))
        paths.append(forger.entry(f"clone-{number}", recorded=actions))
    return paths
