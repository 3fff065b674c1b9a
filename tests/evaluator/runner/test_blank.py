"""Self-audits: a policy without the scene, or without the hand, in a protocol of its own, up to an entry."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from evaluator.cli.main import cli
from evaluator.leaderboard import leaderboard
from evaluator.leaderboard.submission import inspect_run, make_entry
from evaluator.leaderboard.verification import write_record
from evaluator.protocol import BLANKED, PROTOCOLS, acting_steps, protocol_hash
from evaluator.replay import replay
from evaluator.rollout.blank import as_shown
from evaluator.run.entry import encode
from evaluator.run.reading import read_run
from evaluator.runner import run_evaluation
from rema_data.errors import RunMismatchError
from rema_data.schema import TASKS
from tests.evaluator.fakes import FakePolicyProcess, fake_backend, fake_config, fake_observe, fake_scenario
from tests.evaluator.runs import EPISODES, solved, use_installation, write_run

WORLD: dict[str, Any] = {"digest": "d" * 64, "protocol_hash": protocol_hash}


class Watching(FakePolicyProcess):
    """Notes which maps it was shown, and how many actions it might choose from."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: set[tuple[bool, bool, int]] = set()

    def act(self, batch: Any, situations: Any) -> list[Any]:
        for scene, hand, valid in zip(batch.scene, batch.end_effector, batch.valid, strict=True):
            self.seen.add((bool(scene.any()), bool(hand.any()), int(valid.sum())))
        return super().act(batch, situations)


@pytest.fixture(autouse=True)
def _installation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use_installation(tmp_path, monkeypatch)


def played(folder: Path, protocol: str, process: FakePolicyProcess | None = None, **changes: Any) -> Path:
    config = fake_config(folder, protocol=protocol, **{"episodes": EPISODES, "engine": "inline", **changes})
    run_evaluation(config, backend=fake_backend(process, **WORLD))
    return folder


def test_the_clean_protocols_are_what_they_were() -> None:
    """As the entries that come with rema say."""
    known = "1bf87800fe6591abe736cc9796f7b96f6438faa137d12fe3b55805bdd82c2bbb"
    assert protocol_hash("grasp", "conditional") == known
    hashes = {protocol_hash(task, name) for task in TASKS for name in (*PROTOCOLS, *BLANKED)}
    assert len(hashes) == len(TASKS) * 4 and not PROTOCOLS.keys() & BLANKED.keys()
    assert all(acting_steps(task, name) == acting_steps(task, "conditional") for task in TASKS for name in BLANKED)


@pytest.mark.parametrize(("protocol", "scene", "hand"), [("blank-scene", False, True), ("blank-hand", True, False)])
def test_a_part_is_zero_and_the_valid_actions_are_given(tmp_path: Path, protocol: str, scene: bool, hand: bool) -> None:
    clean, blank = Watching(), Watching()
    played(tmp_path / "clean", "conditional", clean, task="grasp_push")
    played(tmp_path / "blank", protocol, blank, task="grasp_push")  # its audit asks again
    assert {(True, True, valid) for _, _, valid in blank.seen} == clean.seen
    assert {seen[:2] for seen in blank.seen} == {(scene, hand)} and blank.asked > EPISODES
    seen = as_shown(fake_observe(fake_scenario("grasp", 3).last_situation()), protocol)
    assert seen.scene.dtype == seen.depth.dtype == np.uint16 and seen.mask.dtype == bool


def test_what_is_blanked_is_no_row_and_no_other_run(tmp_path: Path) -> None:
    clean, blank = (played(tmp_path / name, name) for name in ("conditional", "blank-scene"))
    assert (clean / "results.parquet").read_bytes() != (blank / "results.parquet").read_bytes()
    assert (
        played(tmp_path / "again", "conditional").joinpath("results.parquet").read_bytes()
        == (clean / "results.parquet").read_bytes()
    )
    with pytest.raises(RunMismatchError, match="its protocol is blank-scene"):
        played(blank, "conditional")


def test_resumed_replayed_submitted_and_recorded(tmp_path: Path) -> None:
    whole, parts = played(tmp_path / "whole", "blank-scene"), tmp_path / "parts"
    for episodes in (100, EPISODES):
        played(parts, "blank-scene", episodes=episodes, workers=2, engine="process")
    assert (parts / "results.parquet").read_bytes() == (whole / "results.parquet").read_bytes()
    assert replay(parts, engine="inline", backend=fake_backend(**WORLD)).verified
    inspection = inspect_run(whole, engine="inline", backend=fake_backend(**WORLD))
    assert inspection.valid, [one for one in inspection.checks if not one.passed]
    entry = tmp_path / "manifests" / "leaderboard" / "mine-grasp-blank-scene.json"
    entry.write_bytes(encode(make_entry(inspection, "mine")))
    assert json.loads(entry.read_bytes())["protocol"] == "blank-scene"
    assert write_record(read_run(entry), backend=fake_backend(**WORLD), engine="inline").is_file()


def test_the_board_shows_it_beside_the_policy(tmp_path: Path) -> None:
    rates = {"conditional": 0.9, "blank-scene": 0.05, "blank-hand": 0.6}
    runs = [write_run(tmp_path / name, solved(rate, 3), policy="mine", protocol=name) for name, rate in rates.items()]
    part = write_run(tmp_path / "part", solved(0.5, 3, 50), policy="mine", protocol="blank-hand")
    other = write_run(tmp_path / "other", solved(0.5, 3), policy="other", protocol="blank-hand")
    board = leaderboard([*runs, part, other], published=False)
    (row,) = board.rows
    assert row.blank == {name: read_run(tmp_path / name).counts.rate for name in BLANKED}
    assert (row.rate, row.rank) == (read_run(runs[0]).counts.rate, 1)
    assert any("mine (grasp, blank-hand) is not shown: 50 of 300 scenarios" in text for text in board.remarks)
    assert any("other (grasp, blank-hand) is not shown: its policy has no conditional row" in t for t in board.remarks)
    alone = leaderboard(runs[:1], published=False)
    assert alone.rows[0].blank is None and not alone.remarks[0].startswith("blank")


def test_from_the_command_line(tmp_path: Path) -> None:
    runs = [
        write_run(tmp_path / name, solved(0.5, 3), policy="mine", protocol=name) for name in ("conditional", *BLANKED)
    ]
    arguments = ["leaderboard", *map(str, runs), "--no-entries", "--no-published"]
    done = CliRunner().invoke(cli, [*arguments, "--export", "md"])
    assert done.exit_code == 0 and "blank-scene %" in done.stdout
    site = CliRunner().invoke(cli, [*arguments, "--export", "site", "--output", str(tmp_path / "site")])
    assert site.exit_code == 0, site.output
    (page,) = (tmp_path / "site" / "policies").glob("*-mine.html")
    assert "with the scene blanked: " in page.read_text()
    alone = CliRunner().invoke(cli, ["leaderboard", str(runs[1]), "--no-entries", "--no-published"])
    assert "mine (grasp, blank-scene) is not shown: its policy has no conditional row" in alone.stdout
    none = CliRunner().invoke(
        cli, ["evaluate", "random", "--task", "grasp", "--suite", "x", "--protocol", "blank-hand"]
    )
    assert none.exit_code == 2 and "has no blank-hand protocol" in none.stderr
