"""The entries that travel with the repository, the README's table that is made of them, and the way onto it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.leaderboard import END, PAGE, START, replace_section, section
from evaluator.cli.main import VERBS, cli
from evaluator.engines.child import call_in_child
from evaluator.leaderboard.eligibility import obstacles
from evaluator.leaderboard.naming import installed_digest
from evaluator.leaderboard.suites import BOARD_SUITE
from evaluator.leaderboard.verification import known, records, simulated
from evaluator.policy.named import kind_of
from evaluator.protocol import FLIP_LIMIT
from evaluator.rollout.backend import default_backend
from evaluator.rollout.derive import simulate_recorded
from evaluator.run.actions import recorded_actions
from evaluator.run.derived import Derived
from evaluator.run.entry import find_entries, read_entry
from evaluator.run.plan import Plan, find_list
from evaluator.run.tables import verdict
from evaluator.sim.bullet import decisive
from rema_data.errors import InputError
from rema_data.progress import Silent
from rema_data.schema import TASKS
from tests.evaluator.runs import solved, use_installation, write_entry, write_run, write_suite

ENTRIES = Path(__file__).resolve().parents[2] / "manifests" / "leaderboard"
SAMPLE = 5
POLICIES = ("random", "scripted", "tae-separate", "tae-joint")


def test_every_entry_of_the_repository_is_whole_and_the_only_one_of_its_name() -> None:
    assert (ENTRIES / "README.md").is_file()
    found = [read_entry(path) for path in find_entries()]
    assert sorted(ENTRIES.glob("*.json")) == [run.source for run in found]
    names = [f"{run.policy}-{run.task}-{run.setting}.json" for run in found]
    assert names == [run.source.name for run in found]


def test_the_table_of_the_readme_is_made_from_the_entries() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert replace_section(text, section()) == text


def test_the_board_has_the_four_rows_of_the_papers_table_in_every_task() -> None:
    """Conditional, and from the first step on where there is more than one; each over the whole list.

    Those of the newest format are verified by a record, and ranked.
    """
    tasks = [task for task in TASKS if task != "grasp_grasp_push"]  # which the paper does not score
    wanted = {(policy, task, "conditional") for policy in POLICIES for task in tasks}
    wanted |= {(policy, task, "end-to-end") for policy in POLICIES for task in tasks if len(TASKS[task]) > 1}
    runs = {(run.policy, run.task, run.setting): run for run in (known(read_entry(path)) for path in find_entries())}
    assert wanted <= runs.keys()
    for key in wanted:
        assert len(runs[key].outcomes.success) == 10_000, key
        if runs[key].recorded is not None:
            assert obstacles(runs[key]) == [] and runs[key].verified == "record", key


def recorded() -> list[Path]:
    """Entries that a record covers."""
    known_entries = records()
    return [path for path in find_entries() if read_entry(path).digest in known_entries]


def test_every_entry_of_the_newest_format_has_a_record_and_every_record_an_entry() -> None:
    newest = {run.digest for run in map(read_entry, find_entries()) if run.recorded is not None}
    assert newest == records().keys()
    assert sorted(path.name for path in (ENTRIES / "verified").glob("*.json")) == [path.name for path in recorded()]


def test_rows_of_installed_policies_are_of_the_policies_that_are_here() -> None:
    """Another version of one is another policy: nothing that it plays stands beside these rows any more."""
    for path in recorded():
        entry = read_entry(path)
        if kind_of(entry.policy) is not None:
            assert entry.provenance.policy_digest == installed_digest(entry.policy, entry.task), (
                f"{path.name}: the policy, or something that it imports, has changed: score it again, or undo that"
            )


@pytest.mark.slow
def test_every_record_is_what_its_entry_gives() -> None:
    """On another simulator than the record's, at most 0.5 % of the labels may be others."""
    for path in recorded():
        entry = read_entry(path)
        kept, found = records()[entry.digest], simulated(entry)
        if decisive(kept.fingerprint) == decisive(found.fingerprint):
            assert found.sha256 == kept.rows.sha256, path
        else:
            said = Derived.unpack(kept.rows, len(entry.actions), entry.steps, kept.fingerprint)
            flips = sum(said.label(row) != found.label(row) for row in range(len(entry.actions)))
            assert flips <= FLIP_LIMIT * len(entry.actions), path


def test_a_sample_of_every_record_is_what_its_entry_gives() -> None:
    """A few scenarios, drawn with the record, where the simulator is the record's."""
    if not recorded():
        pytest.skip("no entry has a record yet")
    world = default_backend()
    here = decisive(call_in_child(world.fingerprint))
    for path in recorded():
        entry = read_entry(path)
        kept = records()[entry.digest]
        if decisive(kept.fingerprint) != here:
            continue
        said = Derived.unpack(kept.rows, len(entry.actions), entry.steps, kept.fingerprint)
        scenarios = find_list(entry.task, entry.split, entry.provenance.scenarios_hash, len(entry.actions))
        seed = int(kept.rows.sha256, 16)
        rows = sorted(np.random.default_rng(seed).choice(len(entry.actions), SAMPLE, replace=False).tolist())
        plan = Plan([scenarios.scenarios[row] for row in rows], entry.task, entry.protocol)
        answers = recorded_actions(entry.actions, plan.steps)
        simulate_recorded(plan, answers, world, Silent(), phase="sample", engine="inline", missing_fails=True)
        for row in rows:
            end = verdict(row, plan.steps, answers)
            assert said.label(row) == ("success" if end.success else str(end.failure and end.failure.value)), (
                path,
                row,
            )


def test_a_section_has_every_ranked_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use_installation(tmp_path, monkeypatch)
    runs = [
        write_run(tmp_path / "a", solved(0.5, 1), policy="mine"),
        write_run(tmp_path / "b", solved(0.9, 2), policy="theirs"),
        write_run(
            tmp_path / "c", [solved(0.9, 3), solved(0.5, 4)], policy="mine", task="grasp_push", protocol="end-to-end"
        ),
    ]
    for folder in runs:
        write_entry(tmp_path / "manifests" / "leaderboard" / f"{folder.name}.json", folder)
    text = section()
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    assert [row.split(" | ")[0] for row in rows if "submitted" in row] == ["| theirs", "| mine", "| mine"]
    assert text.index("**Conditional**") < text.index("**End-to-end**")
    page = replace_section(f"# Title\n\n{START}\nold\n{END}\n\nrest\n", text)
    assert "old" not in page and page.endswith(f"{END}\n\nrest\n") and replace_section(page, text) == page


def test_a_section_has_hard_where_a_policy_was_played_over_a_suite(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_installation(tmp_path, monkeypatch)
    write_suite(tmp_path / "manifests", BOARD_SUITE)
    for name, suite in (("mine", None), ("other", None), ("mine", "hard-v1")):
        folder = write_run(
            tmp_path / f"{name}-{suite}",
            solved(0.9, 2, 180) if suite else solved(0.8, len(name)),
            policy=name,
            suite=suite,
        )
        write_entry(tmp_path / "manifests" / "leaderboard" / f"{folder.name}.json", folder)
    rows = {line.split(" | ")[0]: line.split(" | ") for line in section().splitlines() if line.startswith("| ")}
    assert rows["| policy"][2:] == ["grasp", "grasp hard |"]
    assert re.fullmatch(r"9\d\.\d \[8\d\.\d, 9\d\.\d\] \|", rows["| mine"][3])
    assert rows["| other"][3] == "- |"
    assert "hard" in section().splitlines()[-1]


def test_a_page_without_markers_is_left_alone() -> None:
    with pytest.raises(InputError, match="no place"):
        replace_section("# Title\n", "table")


def test_every_command_of_the_guide_exists_with_its_options() -> None:
    guide = (PAGE.parent / "docs" / "submit.md").read_text(encoding="utf-8")
    commands = [line.split() for line in guide.splitlines() if line.startswith("rema ")]
    assert {"evaluate", "report", "submit", "leaderboard"} <= {words[1] for words in commands} <= set(VERBS)
    for words in commands:
        shown = CliRunner().invoke(cli, [words[1], "--help"]).stdout
        for option in re.findall(r"--[a-z-]+", " ".join(words)):
            assert option in shown, words
