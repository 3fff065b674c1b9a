"""Collections of varied episodes, in a light world, and what clean ones keep."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from baselines.rounds.play import draw_scenario
from evaluator.scenarios.varied import Vary
from rema_data.errors import RunMismatchError
from rema_data.release.folder import ReleaseFolder, find_release
from rema_data.store.block import BlockKey
from rema_data.store.tables import outcome_of, situation_of, variation_of
from rema_data.verify import Report, verify
from tests.baselines.rounds.fakes import PLAN, collect_fake, interrupted, tree, write_plan
from tests.evaluator.fakes import FakeSimulator, fake_fingerprint, fake_observe

pytestmark = pytest.mark.usefixtures("quick_fingerprint")


VARY = 'policy = "random"\nvary = { axes = ["clutter", "shape", "sense"], clean = 0.3 }'
VARIED = PLAN.replace('policy = "random"', VARY)
"""Varied in round 1 alone."""
CLEAN_PLAN = "bafe193410b5d25ba427e4bda4ee338cfed51da245af7ecffae73dfc21b0a64a"
"""What the plan of these tests was called before plans could vary."""


def test_the_identity_of_a_clean_plan_stays(finished: ReleaseFolder) -> None:
    """Released plans have this one: no schema version, field or draw may change it."""
    assert finished.manifest.plan_sha256 == CLEAN_PLAN
    assert finished.manifest.schema_version == 1


def test_clean_episodes_are_drawn_as_ever() -> None:
    """Those of the sample, which was collected before there were varied ones."""
    sample = find_release("rema-sample")
    for entry in sample.manifest.blocks:
        block = sample.block(entry)
        seeds = dict(zip(*(block.episodes()[name].to_pylist() for name in ("episode", "seed")), strict=True))
        for row in block.steps().to_pylist():
            drawn = draw_scenario(seeds[row["episode"]], entry.key, row["episode"])
            assert situation_of(row, None).target == drawn.placements[row["step"]]


@pytest.mark.parametrize(("text", "goes_on"), [(VARIED, False), (PLAN, True)])
def test_other_code_of_the_axes_makes_other_varied_episodes_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, goes_on: bool
) -> None:
    """A collection that varies nothing goes on after the axes have changed."""
    plan = write_plan(tmp_path, text)
    recorded = json.loads((interrupted(plan, tmp_path, 8) / "plan.json").read_bytes())
    assert (recorded["code"] == "fake") == goes_on
    monkeypatch.setattr("baselines.rounds.collect.source_digest", lambda *_: "that of an update")
    if goes_on:
        assert collect_fake(plan, tmp_path).release
    else:
        with pytest.raises(RunMismatchError, match="they differ in code"):
            collect_fake(plan, tmp_path)


@pytest.fixture(scope="module")
def varied(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    folder = tmp_path_factory.mktemp("varied")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("baselines.rounds.collect.call_in_child", lambda target: fake_fingerprint())
        return collect_fake(write_plan(folder, VARIED), folder).release


def test_a_varied_episode_can_be_played_again_from_its_row(varied: ReleaseFolder) -> None:
    assert varied.manifest.schema_version == 2
    simulator, cells = FakeSimulator(), set()
    for entry in varied.manifest.blocks:
        block = varied.block(entry)
        assert block.version() == 2  # all blocks of a release, though only one of its rounds is varied
        steps, maps = block.steps().to_pylist(), block.maps()
        for episode in block.episodes().to_pylist():
            variation = variation_of(episode)
            drawn = draw_scenario(7, entry.key, episode["episode"], varied_by(entry.key))
            assert drawn.variation == variation
            for row in steps[episode["first_step"] :][: episode["steps"]]:
                situation = situation_of(row, variation)
                assert situation.target == drawn.placements[row["step"]]
                assert outcome_of(row).failure == simulator.run(situation, row["action"]).failure
                seen = maps.read("ee_depth", row["ee_row"], row["ee_row"] + 1)
                assert np.array_equal(seen[0], fake_observe(situation).depth + 100)
            if variation is not None:
                cells.add(variation.axis)
    assert len(cells) > 1 and not found_by(verify(varied))


def found_by(report: Report) -> set[str]:
    """Kinds of findings, but for those that the light world does not keep in any episode."""
    return report.counts.keys() - {"labels", "maps", "actions"}


def varied_by(key: BlockKey) -> Vary | None:
    return Vary(("clutter", "shape", "sense"), 0.3) if key.round == 1 else None


def test_varied_episodes_are_the_same_with_any_workers_and_chunks(tmp_path: Path, varied: ReleaseFolder) -> None:
    again = collect_fake(write_plan(tmp_path, VARIED), tmp_path, engine="process", workers=3).release
    assert tree(again.path) == tree(varied.path)
    (tmp_path / "other").mkdir()
    larger = collect_fake(write_plan(tmp_path, VARIED), tmp_path / "other", chunk_episodes=100).release
    changed = {name for name, sha256 in tree(larger.path).items() if tree(varied.path)[name] != sha256}
    assert not any(name.startswith("round-") for name in changed)


def test_a_varied_round_continues_a_clean_release(tmp_path: Path) -> None:
    """Blocks of both versions in one release; a clean round that continues it has the columns of the newest."""
    collect_fake(write_plan(tmp_path), tmp_path)
    reuse = 'parent = "tiny"\n' + PLAN[: PLAN.index("[[rounds]]")] + "[[rounds]]\nreuse = true\n\n" * 2
    third = '[[rounds]]\npolicy = "random"\nepisodes = { train = 9 }\ntasks = ["grasp"]\n'
    middle = reuse.replace('"tiny"\ntitle', '"middle"\ntitle') + third + 'vary = ["shape"]\n'
    both = collect_fake(write_plan(tmp_path, middle), tmp_path).release
    assert both.manifest.schema_version == 2
    assert [both.block(block).version() for block in both.manifest.blocks] == [1, 1, 1, 2]
    assert not found_by(verify(both))
    last = reuse.replace('"tiny"\ntitle', '"last"\ntitle').replace('"tiny"', '"middle"')
    whole = collect_fake(write_plan(tmp_path, last + "[[rounds]]\nreuse = true\n\n" + third), tmp_path).release
    assert [whole.block(block).version() for block in whole.manifest.blocks] == [1, 1, 1, 2, 2]
    column = whole.block(whole.manifest.blocks[-1]).episodes()["variation"]
    assert column.null_count == len(column) and not found_by(verify(whole))
