"""Measures against data whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.train.validation import score


def test_a_perfect_and_a_blind_network() -> None:
    success = np.arange(100) % 2 == 0
    skills = np.array(["grasp"] * 100)
    perfect = score(np.where(success, 9.0, -9.0), success, skills)
    assert perfect["auc"] == perfect["balanced_accuracy"] == 1.0 and perfect["calibration_error"] < 0.001
    blind = score(np.zeros(100), success, skills)
    assert blind["auc"] == blind["balanced_accuracy"] == 0.5 and blind["loss"] == pytest.approx(np.log(2))
    assert score(np.where(success, -9.0, 9.0), success, skills)["auc"] == 0.0


def test_auc_is_the_share_of_pairs_in_order() -> None:
    rng = np.random.default_rng(0)
    logit, success = rng.normal(size=60).round(1), rng.random(60) < 0.3
    won, lost = logit[success][:, None], logit[~success][None]
    expected = ((won > lost) + 0.5 * (won == lost)).mean()
    assert score(logit, success, np.array(["push"] * 60))["auc"] == pytest.approx(expected)


def test_skills_count_equally_at_any_size() -> None:
    success = np.array([True, False] * 50 + [True, False])
    skills = np.array(["grasp"] * 100 + ["grasp_grasp"] * 2)
    logit = np.where(success, 1.0, -1.0)
    logit[-2:] *= -1  # wrong on the small skill alone
    measures = score(logit, success, skills)
    assert measures["auc"] == 0.5
    assert measures["skills"]["grasp_grasp"] == {"successes": 1, "failures": 1, "auc": 0.0, "balanced_accuracy": 0.0}


def test_a_skill_without_both_labels_is_left_out_of_the_means() -> None:
    success = np.array([True, False] * 50 + [False] * 3)
    skills = np.array(["grasp"] * 100 + ["grasp_grasp"] * 3)
    measures = score(np.where(success, 1.0, -1.0), success, skills)
    assert measures["auc"] == measures["balanced_accuracy"] == 1.0
    assert score(np.zeros(3), success[-3:], skills[-3:])["auc"] == 0.5


def test_calibration_does_not_depend_on_how_many_of_each_label_there_are() -> None:
    """Half a chance for everything is right when both labels weigh the same."""
    success = np.array([True] * 5 + [False] * 95)
    measures = score(np.zeros(100), success, np.array(["grasp"] * 100))
    assert measures["calibration_error"] == pytest.approx(0.0)


def test_confident_wrong_answers() -> None:
    success = np.array([True, False] * 20)
    measures = score(np.full(40, 6.0), success, np.array(["grasp"] * 40))
    assert measures["calibration_error"] == pytest.approx(0.5, abs=0.01)
