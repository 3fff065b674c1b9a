"""A run in the viewer: its results row for row, steps from recorded actions, and runs that cannot be shown."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from evaluator.run.reading import read_run
from evaluator.view import Viewer, open_source
from rema_data.errors import InputError, IntegrityError, MissingFileError
from tests.evaluator.runs import EPISODES, solved, use_installation, write_run


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    use_installation(tmp_path, monkeypatch)
    return tmp_path


def test_every_row_of_the_results_is_an_episode(installed: Path) -> None:
    lost = np.zeros(EPISODES, bool)
    lost[:7] = True
    folder = write_run(installed / "run", solved(0.4, 1), lost=lost)
    viewer = Viewer(open_source(str(folder)))
    run, table = read_run(folder), viewer.source.table
    assert len(table) == EPISODES
    for place, recorded in enumerate(run.rows):
        row = table.row(place)
        outcome = {True: "success", False: "failed", None: "not measured"}[recorded["success"]]
        assert (row["id"], row["outcome"]) == (recorded["scenario"], outcome)
        for name in ("failure", "failed_step", "target_shape", "target_x_m", "sim_steps", "infra_error"):
            assert row[name] == recorded[name]
        for name in ("lift_m", "contact_steps", "arm"):
            assert row[name] == recorded[f"step0_{name}"]
    counts = viewer.rows("")["counts"]["outcome"]
    assert counts == {"success": run.counts.successes, "failed": run.counts.eligible - run.counts.successes} | {
        "not measured": 7
    }


def test_the_evidence_of_an_episode_is_that_of_the_step_that_decided_it(installed: Path) -> None:
    first, second = solved(0.6, 1), solved(0.5, 2)
    folder = write_run(installed / "run", [first, second], task="grasp_push", protocol="end-to-end")
    viewer = Viewer(open_source(str(folder)))
    for place, recorded in enumerate(read_run(folder).rows):
        decided = 0 if recorded["failed_step"] == 0 else 1
        row = viewer.source.table.row(place)
        assert row["contact_steps"] == recorded[f"step{decided}_contact_steps"]
        steps = viewer.episode(recorded["scenario"])["steps"]
        assert [step["step"] for step in steps] == ([0] if decided == 0 else [0, 1])
        assert steps[-1]["success"] == recorded["success"]


def test_a_step_is_played_again_as_it_was_recorded(push_run: Path) -> None:
    viewer = Viewer(open_source(str(push_run)))
    name = viewer.rows("outcome=success")["rows"][0]["id"]
    assert viewer.picture(name, 0, "scene").startswith(b"\x89PNG")
    played = viewer.stills(name, 0)
    assert (played["agreement"], played["again"]) == ("identical", "success")
    assert played["before"].startswith("data:image/webp") and played["after"].startswith("data:image/webp")
    assert viewer.film(name, 0)["film"].startswith("data:image/webp")


def test_an_episode_without_an_answer_has_words_and_no_picture(push_run: Path) -> None:
    viewer = Viewer(open_source(str(push_run)))
    name = viewer.rows("failure=policy_error")["rows"][0]["id"]
    (step,) = viewer.episode(name)["steps"]
    assert step["action"] is None and "the policy raised" in step["why"]
    for ask in (viewer.stills, viewer.film):
        with pytest.raises(InputError, match="the policy gave no action"):
            ask(name, 0)
    with pytest.raises(InputError, match="the policy gave no action"):
        viewer.picture(name, 0, "scene")


def test_a_run_of_other_scenarios_is_listed_without_pictures(installed: Path) -> None:
    folder = write_run(installed / "run", solved(0.4, 1), identity={"scenarios_hash": "0" * 64}, verified=False)
    viewer = Viewer(open_source(str(folder)))
    assert any("cannot be drawn or played again here" in notice.message for notice in viewer.source.notices)
    assert viewer.rows("")["total"] == EPISODES


def test_an_unfinished_run_says_how_to_finish_it(installed: Path) -> None:
    folder = write_run(installed / "run", solved(0.4, 1))
    (folder / "summary.json").unlink()
    with pytest.raises(MissingFileError, match="no finished run") as caught:
        open_source(str(folder))
    assert "rema evaluate" in caught.value.hint


def test_a_damaged_run_is_refused(installed: Path) -> None:
    folder = write_run(installed / "run", solved(0.4, 1))
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps({**summary, "successes": 1 + summary["successes"]}))
    with pytest.raises(IntegrityError, match="successes"):
        open_source(str(folder))


def test_an_entry_and_an_empty_folder_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("REMA_MANIFESTS", raising=False)
    (tmp_path / "entry.json").write_text("{}")
    with pytest.raises(InputError, match="is a file"):
        open_source(str(tmp_path / "entry.json"))
    with pytest.raises(MissingFileError, match="neither a sealed release nor a finished run") as caught:
        open_source(str(tmp_path))
    assert "rema evaluate" in caught.value.hint
