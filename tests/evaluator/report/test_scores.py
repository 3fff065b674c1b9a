"""The policy asked again: its maps on the cards, its calibration, and refusals in a sentence."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from evaluator.policy import PolicySpec
from evaluator.report import ReportOptions, write_report
from evaluator.report.scores import ask_scores, check_policy
from evaluator.run.reading import read_run
from rema_data import grid
from rema_data.errors import RunMismatchError, SubmissionError
from rema_data.schema import ObjectSpec, Placement, Shape, Situation
from tests.evaluator.report.conftest import POLICY, evaluate_pushes
from tests.evaluator.report.pages import Page

SITUATION = Situation("push", 0, Placement(ObjectSpec(Shape.I, 0.1, 0.03, 0.0, 0.03), 0.0, 0.0, 0.0))


def policy(class_name: str) -> PolicySpec:
    return PolicySpec("scoring", POLICY, class_name)


def test_scores_are_those_of_the_recorded_actions() -> None:
    cells = [(20, 10, 0), (30, 40, 8), (50, 32, 15)]
    asked = ask_scores(policy("ScoringPolicy"), [(SITUATION, int(grid.encode(*cell))) for cell in cells])
    assert [one.chosen for one in asked] == pytest.approx([j / 64 * (1 - k / 16) for _, j, k in cells])
    assert asked[0].best.shape == (64, 64)
    assert asked[0].best[30, 40] == pytest.approx(40 / 64)
    assert asked[0].best[0, 0] != asked[0].best[0, 0]  # where no action is valid


def test_maps_and_calibration_are_on_the_page(push_run: Path, tmp_path: Path) -> None:
    options = ReportOptions(per_label=1, policy=policy("ScoringPolicy"), scored=15)
    written = write_report(push_run, tmp_path / "page.html", options)
    page = Page(written.path)
    assert written.scored == 15
    assert "asked again about 15 episodes" in page.text
    maps = [picture for picture in page.all("img") if (picture["alt"] or "").startswith("Map of the policy's scores")]
    assert len(maps) == sum(written.agreement.values()) > 0
    assert page.text.count("is the highest of the map") == len(maps)


def test_without_a_policy_the_page_says_that_there_are_no_scores(push_run: Path, tmp_path: Path) -> None:
    written = write_report(push_run, tmp_path / "page.html", ReportOptions(per_label=0))
    assert written.scored == 0
    assert "A run records actions and no scores" in Page(written.path).text


def test_scores_outside_0_to_1_have_no_calibration(installation: Path, tmp_path: Path) -> None:
    spec = policy("OddsPolicy")
    evaluate_pushes(tmp_path / "run", spec)
    written = write_report(tmp_path / "run", options=ReportOptions(per_label=0, policy=spec))
    assert written.scored == 0
    assert "not shares between 0 and 1" in Page(written.path).text


@pytest.mark.parametrize(
    ("class_name", "reason"),
    [
        ("SilentPolicy", "has no method maps"),
        ("FlatPolicy", "maps has shape"),
        ("RaisingPolicy", r"ValueError: no idea .*scoring_policy\.py"),
        ("DyingPolicy", "ended with exit code 5"),
    ],
)
def test_a_policy_without_maps_is_refused(class_name: str, reason: str) -> None:
    with pytest.raises(SubmissionError, match=reason):
        ask_scores(policy(class_name), [(SITUATION, 0)])


def test_it_runs_in_the_sandbox_of_an_evaluation(tmp_path: Path) -> None:
    """It sees neither the outcomes that its scores are compared with nor the network."""
    mine = tmp_path / "mine.py"
    shutil.copy(POLICY, mine)
    run = tmp_path / "runs" / "one"
    run.mkdir(parents=True)
    (run / "run.json").write_text("{}")
    (run / "results.parquet").write_text("outcomes")
    notes: list[str] = []
    spec = PolicySpec("mine", mine, "CuriousPolicy")
    (seen,) = ask_scores(spec, [(SITUATION, 0)], run=run, note=notes.append)
    if "isolation L1" in notes[0]:
        pytest.skip(notes[0])
    assert seen.chosen == 0  # of its tries


def test_another_policy_is_refused(push_run: Path, tmp_path: Path) -> None:
    run = read_run(push_run)
    check_policy(run, policy("ScoringPolicy"), None)
    changed = shutil.copy(POLICY, tmp_path / "policy.py")
    changed.write_text(POLICY.read_text() + "# another one\n")
    for other in (policy("SilentPolicy"), PolicySpec("scoring", changed, "ScoringPolicy")):
        with pytest.raises(RunMismatchError, match="is not the policy of"):
            write_report(push_run, tmp_path / "page.html", ReportOptions(policy=other))
    assert not (tmp_path / "page.html").exists()
