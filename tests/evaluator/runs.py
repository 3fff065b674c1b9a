"""Finished run folders without a run: whole and sealed, with the outcomes that a test wants."""

from __future__ import annotations

import dataclasses
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
import pytest

from evaluator.engines import InfraError
from evaluator.leaderboard.naming import installed_digest
from evaluator.policy.named import policy_names
from evaluator.protocol import acting_steps, protocol_hash
from evaluator.rollout.backend import default_backend
from evaluator.rollout.derive import world_identity
from evaluator.run.actions import actions_of, encode_actions
from evaluator.run.counts import count_rows, unfinished
from evaluator.run.derived import derived_of, remember
from evaluator.run.entry import encode
from evaluator.run.header import RUN_FILE, RUN_FORMAT, encode_header
from evaluator.run.plan import Plan, scenario_list
from evaluator.run.reading import read_run
from evaluator.run.records import Answered, Records, Simulated
from evaluator.run.seal import ACTIONS_FILE, RESULTS_FILE, SUMMARY_FILE, seal_of
from evaluator.run.summary import summarise
from evaluator.run.tables import results_table, to_parquet
from evaluator.scenarios import load_list, update_manifest, write_list
from evaluator.scenarios.suite import shuffled
from rema_data import grid
from rema_data.errors import RunMismatchError
from rema_data.schema import Failure, Scenario, StepOutcome
from rema_data.variation import Variation
from tests.evaluator.fakes import write_fake_list

EPISODES = 300
"""Scenarios of the fake lists."""
FINGERPRINT = {"pybullet": "3.2.7", "parameters": "a" * 64, "probe": "b" * 64}
AUDIT: dict[str, Any] = {
    **{"episodes": 30, "actions": 30, "action_flips": 0, "action_flips_ci95": [0.0, 0.12]},
    **{"outcomes": 30, "outcome_flips": 0, "outcome_flips_ci95": [0.0, 0.12], "lost": 0, "flipped": []},
}
END: dict[str, Any] = {"policy_error_reasons": {}, "nondeterministic": 0, "audit": AUDIT, "stopped_early": None}
"""What a whole run notes when it is sealed."""
STOPPED: dict[str, Any] = {"against": "other", "verdict": "better"}
"""What a quick look notes, shortened."""
MANIFESTS = Path(__file__).resolve().parents[2] / "manifests"

Bools = npt.NDArray[np.bool_]


def write_manifests(folder: Path, tasks: tuple[str, ...] = ("grasp", "grasp_push")) -> None:
    """Small lists, the paper's table, and no entry."""
    for name, content in _lists(tasks).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    shutil.copytree(MANIFESTS / "published", folder / "published")
    (folder / "leaderboard").mkdir()


SUITE_AXES = {"clutter": 3, "shape": 3, "posts": 3}
"""Axes of the fake suite, the last of which does not count in ``hard``, and their levels."""
SUITE_BASES = 20
"""Clean scenarios of every axis of the fake suite."""


def write_suite(folder: Path, name: str = "tough-v1", task: str = "grasp") -> list[Scenario]:
    """A suite below a folder of manifests, made of the fake list there: its scenarios, in the order of the list."""
    clean = load_list(task).scenarios
    varied = [
        dataclasses.replace(clean[base], variation=Variation(axis, level, base))
        for number, (axis, levels) in enumerate(SUITE_AXES.items())
        for level in range(1, levels + 1)
        for base in range(SUITE_BASES * number, SUITE_BASES * (number + 1))
    ]
    order = shuffled(len(varied), task, "test")
    scenarios = [dataclasses.replace(varied[old], index=new) for new, old in enumerate(order)]
    manifest = folder / "scenarios" / name / "manifest.json"
    manifest.parent.mkdir(parents=True)
    manifest.write_text(json.dumps({"version": name, "suite": {}, "lists": {}}))
    file = manifest.parent / f"{task}_test.parquet"
    about = {"file": file.name, "sha256": write_list(file, scenarios), "count": len(scenarios), "seed_domain": "x"}
    update_manifest(manifest, name, f"{task}/test", **about)  # type: ignore[arg-type]
    return scenarios


def use_installation(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let this process use the manifests of ``write_manifests`` and a cache of its own, both below ``folder``."""
    write_manifests(folder / "manifests")
    monkeypatch.setenv("REMA_MANIFESTS", str(folder / "manifests"))
    monkeypatch.setenv("REMA_HOME", str(folder / "home"))


def write_entry(path: Path, folder: Path, **changes: Any) -> Path:
    """Write the entry of a run as `rema submit` does, without its checks; ``changes`` are of fields of ``Run``."""
    run = read_run(folder)
    path.write_bytes(encode(dataclasses.replace(run, **{"kind_of_policy": run.tag, **changes})))
    return path


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
    suite: str | None = None,
    policy: str = "my_policy",
    digest: str = "",
    identity: dict[str, Any] | None = None,
    verified: bool = True,
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
    suite : str, optional
        The suite that it was played over.
    digest : str
        Of the policy; made from its name by default.
    identity : dict, optional
        Changes of the identity in ``run.json``.
    verified : bool
        Whether this installation remembers that it simulated the run.
    **summary
        Changes of ``end`` in ``run.json``, of ``privileged``, ``simulator``, ``adapted`` and ``isolation``; or else of
        the summary.
    """
    steps = acting_steps(task, protocol)
    passed = [success] if isinstance(success, np.ndarray) else list(success)
    count = len(passed[0])
    scenarios = load_list(task, split, suite)
    none = np.zeros(count, bool)
    actions = np.random.default_rng(list((policy + digest).encode())).choice(
        np.flatnonzero(_valid()), (count, len(steps))
    )
    records = _records(steps, passed, actions, none if lost is None else lost, none if unplayed is None else unplayed)
    table = results_table(scenarios, count, steps, records)
    marks = {
        "policy_digest": digest or _digest(policy, task),
        "protocol_hash": protocol_hash(task, protocol),
        "scenarios_hash": scenarios.sha256,
        "fingerprint": FINGERPRINT,
        **(identity or {}),
    }
    privileged = bool(summary.pop("privileged", False))
    tags = {tag: True for tag in ("simulator", "adapted") if summary.pop(tag, False)}
    header = {
        "format": RUN_FORMAT,
        "identity": {"task": task, "split": split, "protocol": protocol, **marks},
        "policy": {"name": policy, "file": f"{policy}.py", "class_name": "Policy", "privileged": privileged, **tags},
        "episodes": count,
        "salt": "5",
        "segments": [
            {
                **{"number": 1, "versions": {"rema": "0.1.0"}, "commit": None, "dirty": None, "engine": "process"},
                **{"workers": 1, "seconds": {"total": 1.0}, "finished": 1},
            }
        ],
        "end": dict(END),
    }
    if (level := summary.pop("isolation", None)) is not None:
        header["segments"][0]["isolation"] = {"level": level}
    folder.mkdir(parents=True)
    _seal(folder, header, table, summary)
    if verified:
        write_verified(folder)
    return folder


def write_verified(folder: Path) -> None:
    """Let this installation remember that it simulated the actions of a run, with the outcomes that the run has."""
    header, table = json.loads((folder / RUN_FILE).read_text()), pq.read_table(folder / RESULTS_FILE)
    identity = header["identity"]
    rules = {name: identity[name] for name in ("task", "split", "protocol", "protocol_hash", "scenarios_hash")}
    steps = acting_steps(identity["task"], identity["protocol"])
    found = derived_of(table, steps, identity["fingerprint"])
    remember(world_identity(default_backend()), rules, actions_of(table, steps), found)


def reseal(folder: Path, table: pa.Table | None = None, identity: dict[str, Any] | None = None, **summary: Any) -> Path:
    """Change a run and seal it again, as somebody does who knows the format.

    Parameters
    ----------
    folder : Path
    table : pyarrow.Table, optional
        New rows; the action log and the summary follow them.
    identity : dict, optional
        Changes of the identity in ``run.json``.
    **summary
        Changes of ``end`` in ``run.json``, or else of the summary.
    """
    header = json.loads((folder / RUN_FILE).read_text())
    header["identity"].update(identity or {})
    header.pop("seal", None)
    _seal(folder, header, pq.read_table(folder / RESULTS_FILE) if table is None else table, summary)
    return folder


def _seal(folder: Path, header: dict[str, Any], table: pa.Table, changes: dict[str, Any]) -> None:
    identity = header["identity"]
    steps = acting_steps(identity["task"], identity["protocol"])
    header["end"].update({name: changes.pop(name) for name in END.keys() & changes.keys()})
    try:
        left = unfinished(
            Plan(scenario_list(header).scenarios[: table.num_rows], identity["task"], identity["protocol"]), table
        )
    except RunMismatchError:
        left = 0
    summary = {**summarise(header, count_rows(table, steps), table, left), **changes}
    files = {RESULTS_FILE: to_parquet(table), ACTIONS_FILE: encode_actions(actions_of(table, steps))}
    header["seal"] = seal_of(header, files)
    texts = {SUMMARY_FILE: json.dumps(summary, indent=2) + "\n", RUN_FILE: encode_header(header)}
    for name, data in {**files, **{name: text.encode() for name, text in texts.items()}}.items():
        (folder / name).write_bytes(data)


def _digest(policy: str, task: str) -> str:
    if policy in policy_names():
        return installed_digest(policy, task)
    return (policy.encode().hex() + "0" * 64)[:64]


def _records(
    steps: Sequence[int],
    passed: Sequence[Bools],
    actions: npt.NDArray[np.int64],
    lost: Bools,
    unplayed: Bools,
) -> Records:
    """An episode that fails a step does not play the next one."""
    records = Records()
    for index in np.flatnonzero(~unplayed).tolist():
        for step, success, action in zip(steps, passed, actions[index].tolist(), strict=True):
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
