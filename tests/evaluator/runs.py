"""Finished run folders without a run: whole and sealed, with the outcomes that a test wants."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from evaluator.engines import InfraError
from evaluator.protocol import acting_steps, protocol_hash
from evaluator.run.actions import actions_of, encode_actions
from evaluator.run.counts import count_rows, summary_numbers
from evaluator.run.header import RUN_FILE, RUN_FORMAT, encode_header
from evaluator.run.merkle import merkle_root
from evaluator.run.records import Answered, Records, Simulated
from evaluator.run.rows import row_leaves
from evaluator.run.seal import ACTIONS_FILE, LEAVES_FILE, RESULTS_FILE, SUMMARY_FILE, make_seal
from evaluator.run.tables import results_table, to_parquet
from evaluator.scenarios import load_list
from rema_data import grid
from rema_data.schema import Failure, StepOutcome
from tests.evaluator.fakes import write_fake_list

EPISODES = 300
"""Scenarios of the fake lists."""
FINGERPRINT = {"pybullet": "3.2.7", "parameters": "a" * 64, "probe": "b" * 64}
AUDIT: dict[str, Any] = {
    **{"episodes": 30, "actions": 30, "action_flips": 0, "action_flips_ci95": [0.0, 0.12]},
    **{"outcomes": 30, "outcome_flips": 0, "outcome_flips_ci95": [0.0, 0.12], "lost": 0, "flipped": []},
}
RUNTIME: dict[str, Any] = {
    **{"policy_error_reasons": {}, "isolation": None, "seconds": {"total": 1.0}, "episodes_per_second": 1.0},
    **{"engine": "process", "workers": 1, "segments": 1},
}
MANIFESTS = Path(__file__).resolve().parents[2] / "manifests"

Bools = npt.NDArray[np.bool_]


def write_manifests(folder: Path, tasks: tuple[str, ...] = ("grasp", "grasp_push")) -> None:
    """Small lists, the paper's table, and no entry."""
    for name, content in _lists(tasks).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    shutil.copytree(MANIFESTS / "published", folder / "published")
    (folder / "leaderboard").mkdir()


@lru_cache
def _lists(tasks: tuple[str, ...]) -> dict[str, bytes]:
    """Files of the lists; they are the same for every test."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        for task in tasks:
            write_fake_list(folder, task, EPISODES)
        write_fake_list(folder, tasks[0], EPISODES, "val")
        return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def solved(rate: float, seed: int, count: int = EPISODES) -> Bools:
    """Which scenarios a policy of this rate solves."""
    return np.random.default_rng([seed, count]).random(count) < rate


def write_run(
    folder: Path,
    success: Bools | Sequence[Bools],
    *,
    lost: Bools | None = None,
    unplayed: Bools | None = None,
    task: str = "grasp",
    split: str = "test",
    protocol: str = "conditional",
    policy: str = "my_policy",
    digest: str = "",
    identity: dict[str, Any] | None = None,
    **summary: Any,
) -> Path:
    """Write a run folder as `rema evaluate` leaves it.

    Parameters
    ----------
    folder : Path
    success : bool (N,), or one such array for every acting step
        Of the first N scenarios.
    lost : bool (N,), optional
        Episodes lost to the infrastructure.
    unplayed : bool (N,), optional
        Episodes of other shards.
    task, split, protocol, policy : str
    digest : str
        Of the policy; made from its name by default.
    identity : dict, optional
        Changes of the identity in ``run.json`` and in the summary.
    **summary
        Changes of the summary, sealed as if the evaluator had written them.
    """
    steps = acting_steps(task, protocol)
    passed = [success] if isinstance(success, np.ndarray) else list(success)
    count = len(passed[0])
    scenarios = load_list(task, split)
    none = np.zeros(count, bool)
    records = _records(steps, passed, none if lost is None else lost, none if unplayed is None else unplayed)
    table = results_table(scenarios, count, steps, records)
    marks = {
        "policy_digest": digest or (policy.encode().hex() + "0" * 64)[:64],
        "protocol_hash": protocol_hash(task, protocol),
        "scenarios_hash": scenarios.sha256,
        "fingerprint": FINGERPRINT,
        **(identity or {}),
    }
    privileged = bool(summary.get("privileged", False))
    content = {
        **{"task": task, "split": split, "policy": policy, "privileged": privileged, "protocol": protocol},
        **summary_numbers(count_rows(table, steps), table),
        **RUNTIME,
        **{"unfinished": 0, "nondeterministic": 0, "audit": AUDIT, "merkle_root": merkle_root(row_leaves(table)).hex()},
        **marks,
        **summary,
    }
    header = {
        "format": RUN_FORMAT,
        "identity": {"task": task, "split": split, "protocol": protocol, **marks},
        "policy": {"name": policy, "file": f"{policy}.py", "class_name": "Policy", "privileged": privileged},
        "episodes": count,
        "salt": "5",
        "segments": [{"number": 1, "versions": {"rema": "0.1.0"}, "commit": None, "dirty": None, "engine": "process"}],
    }
    if content["isolation"] is not None:
        header["segments"][0]["isolation"] = {"level": content["isolation"]}
    folder.mkdir(parents=True)
    _seal(folder, header, table, content)
    return folder


def reseal(folder: Path, table: pa.Table | None = None, identity: dict[str, Any] | None = None, **summary: Any) -> Path:
    """Change a run and seal it again, as somebody does who knows the format.

    Parameters
    ----------
    folder : Path
    table : pyarrow.Table, optional
        New rows; the action log and the hash tree follow them.
    identity : dict, optional
        Changes of the identity in ``run.json``.
    **summary
        Changes of the summary.
    """
    header = json.loads((folder / RUN_FILE).read_text())
    header["identity"].update(identity or {})
    header.pop("seal", None)
    rows = pq.read_table(folder / RESULTS_FILE) if table is None else table
    content = {**json.loads((folder / SUMMARY_FILE).read_text()), **summary}
    if table is not None:
        content["merkle_root"] = merkle_root(row_leaves(rows)).hex()
    _seal(folder, header, rows, content)
    return folder


def _seal(folder: Path, header: dict[str, Any], table: pa.Table, summary: dict[str, Any]) -> None:
    steps = acting_steps(header["identity"]["task"], header["identity"]["protocol"])
    leaves = row_leaves(table)
    files = {
        RESULTS_FILE: to_parquet(table),
        ACTIONS_FILE: encode_actions(actions_of(table, steps)),
        LEAVES_FILE: b"".join(leaves),
        SUMMARY_FILE: (json.dumps(summary, indent=2) + "\n").encode(),
    }
    unfinished = summary["unfinished"]
    header["seal"] = make_seal(header, files, root=merkle_root(leaves), steps=steps, unfinished=unfinished)
    for name, data in {**files, RUN_FILE: encode_header(header).encode()}.items():
        (folder / name).write_bytes(data)


def _records(steps: Sequence[int], passed: Sequence[Bools], lost: Bools, unplayed: Bools) -> Records:
    """An episode that fails a step does not play the next one; every action is the same valid one."""
    records, action = Records(), int(np.flatnonzero(_valid())[0])
    for index in np.flatnonzero(~unplayed).tolist():
        for step, success in zip(steps, passed, strict=True):
            failure = None if success[index] else Failure.MISSED
            outcome: StepOutcome | InfraError = StepOutcome(
                bool(success[index]),
                failure,
                arm="left",
                lift_m=0.3 * bool(success[index]),
                contact_steps=5,
                sim_steps=100,
            )
            if lost[index]:
                outcome = InfraError("died", "the worker died")
            records.add_answers([Answered(index, step, action)])
            records.add_outcomes([Simulated(index, step, outcome, 0.0, "w", 1)])
            if not success[index] or lost[index]:
                break
    return records


def _valid() -> Bools:
    valid = np.zeros((grid.SCENE_PIXELS, grid.SCENE_PIXELS, grid.ANGLES), bool)
    valid[grid.inside_valid_square()] = True
    return valid
