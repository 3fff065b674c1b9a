"""`check_policy` and `rema check`: good policies pass, and every way to be bad is named with its fix."""

from __future__ import annotations

import json
import sys
import textwrap
from pathlib import Path

import pytest
from click.testing import CliRunner

from evaluator.cli.main import cli
from evaluator.policy import check as checking
from evaluator.policy import check_report
from evaluator.policy.check import PolicyReport, check_policy
from evaluator.policy.questions import questions
from evaluator.policy.sandbox.limits import PolicyLimits
from rema_data.errors import InputError, MissingFileError
from rema_data.schema import TASKS

GOOD = "return good(observations)"
TOP = """
import os, sys, time
import numpy as np
def good(observations):
    return np.array([np.flatnonzero(valid)[int(scene.sum() * 1e4) % valid.sum()]
                     for scene, valid in zip(observations.scene, observations.valid)])
"""


def write(folder: Path, act: str, init: str = "self.count = 0", class_name: str = "Policy") -> str:
    path = folder / "mine.py"
    path.write_text(
        f"{TOP}\nclass {class_name}:\n    def __init__(self, checkpoint, device):\n"
        f"{textwrap.indent(init, ' ' * 8)}\n    def act(self, observations):\n{textwrap.indent(act, ' ' * 8)}\n"
    )
    return str(path)


def checked(folder: Path, act: str, init: str = "self.count = 0") -> dict[str, checking.CheckResult]:
    report = check_policy(write(folder, act, init), task="grasp")
    assert report.ok == all(result.status != "refused" for result in report.results)
    assert all(bool(result.fix) == (result.status != "ok") for result in report.results)
    return {result.name: result for result in report.results}


def refused(results: dict[str, checking.CheckResult]) -> list[str]:
    return [name for name, result in results.items() if result.status == "refused"]


def test_a_good_policy(tmp_path: Path) -> None:
    report = check_policy(write(tmp_path, GOOD), task="grasp")
    assert report.ok and not report.privileged
    results = {result.name: result for result in report.results}
    assert results["valid actions"].found == "64 of 64; returned int64 (N,)"
    assert results["batch size"].found == "15 of 15 answers were the same in batches of 1, 7 and 64"
    assert results["order"].found == "64 of 64 answers were the same in reverse order"
    assert report.seconds_per_decision and report.projected_s == 10_000 * report.seconds_per_decision
    assert report.isolation in ("L1", "L2") and report.decisions > 64
    if sys.platform == "linux":
        assert report.peak_memory_bytes and report.peak_memory_bytes > 1 << 20


def test_it_is_asked_about_every_step_of_every_task() -> None:
    asked = [(one.batch.task, one.batch.step) for task in TASKS for one in questions(task, 2)]
    assert asked == [(task, step) for task, steps in TASKS.items() for step in range(len(steps))]
    first, last = questions("grasp_push", 3)[0], questions("grasp_grasp_push", 3)[-1]
    assert not first.situations[0].grips
    assert len(last.situations[0].grips) == 2 and last.situations[0].pinch is not None
    part = last.part(slice(None, None, -1))
    assert part.situations == last.situations[::-1] and (part.batch.scene == last.batch.scene[::-1]).all()


def test_a_privileged_policy_is_shown_the_situations() -> None:
    report = check_policy("scripted", task=["push"])
    assert report.ok and report.privileged and report.tasks == ("push",)


@pytest.mark.parametrize(
    ("act", "name", "words"),
    [
        ("return np.random.default_rng().integers(600, size=len(observations)) + 30000", "same again", "differed"),
        ("self.count += 1\nreturn (good(observations) + 16 * self.count) % 65536", "same again", "differed"),
        ("return good(observations) * 0 + 30000 + len(observations)", "batch size", "differed"),
        ("return np.full(len(observations), 30000 + os.getpid() % 100)", "new process", "differed"),
        ("return 30000 + np.arange(len(observations))", "order", "differed"),
        ("return good(observations).astype(float)", "valid actions", "wrong_dtype: returned dtype float64"),
        ("return good(observations)[:, None]", "valid actions", "wrong_shape: returned shape"),
        ("return np.full((len(observations), 3), np.nan)", "valid actions", "nan: returned"),
        ("return np.full(len(observations), 70000)", "valid actions", "out_of_range: grid index 70000"),
        ("return np.zeros(len(observations), int)", "valid actions", "is not in `valid`"),
        ("raise ValueError('no idea')", "valid actions", "exception: ValueError: no idea"),
        ("os._exit(3)", "valid actions", "died: ended with exit code 3"),
    ],
)
def test_a_bad_policy_is_refused_with_a_fix(tmp_path: Path, act: str, name: str, words: str) -> None:
    results = checked(tmp_path, act)
    assert name in refused(results)
    assert words in results[name].found


def test_some_faults_are_a_warning(tmp_path: Path) -> None:
    act = "answers = good(observations)\nanswers[[scene.sum() * 1e4 % 64 < 2 for scene in observations.scene]] = 0\n"
    result = checked(tmp_path, act + "return answers")["valid actions"]
    assert (result.status, result.fix != "") == ("warning", True), result


@pytest.mark.parametrize(
    ("init", "words"),
    [
        ("raise ValueError('no weights')", "ValueError: no weights"),
        ("import torhc", "No module named 'torhc'"),
        ("os._exit(1)", "ended with exit code 1 while it started"),
    ],
)
def test_a_policy_that_does_not_load(tmp_path: Path, init: str, words: str) -> None:
    report = check_policy(write(tmp_path, GOOD, init))
    assert [result.name for result in report.results] == ["loads"] and not report.ok
    assert words in report.results[0].found and report.results[0].fix
    assert report.projected_s is None and report.decisions == 0
    json.dumps(report.to_dict())


def test_a_slow_policy_is_asked_less_and_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checking, "_BUDGET_S", 1.0)
    results = checked(tmp_path, "time.sleep(0.02 * len(observations))\nreturn good(observations)")
    assert refused(results) == [] and int(results["valid actions"].found.split()[0]) < 20
    monkeypatch.setattr(check_report, "_LIMITS", PolicyLimits(batch_s=0.5, observation_s=0.001))
    results = checked(tmp_path, "time.sleep(0.02 * len(observations))\nreturn good(observations)")
    assert refused(results) == ["time"] and "within 0.5 s" in results["time"].fix


def test_a_policy_that_hangs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        checking, "_LIMITS", PolicyLimits(batch_s=0.5, observation_s=0.1, single_s=0.5, deaths_in_row=1)
    )
    results = checked(tmp_path, "time.sleep(60)")
    assert refused(results) == ["valid actions"] and "timeout: no answer within 0.5 s" in results["valid actions"].found


def test_what_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no policy is called"):
        check_policy("nobody")
    with pytest.raises(InputError, match="unknown task"):
        check_policy("random", task="fly")
    with pytest.raises(MissingFileError, match="does not exist"):
        check_policy(write(tmp_path, GOOD), checkpoint=tmp_path / "none")


def rema(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(cli, ["check", *arguments], prog_name="rema")
    return result.exit_code, result.stdout


def test_the_command_prints_a_table_for_people(tmp_path: Path) -> None:
    code, shown = rema(write(tmp_path, GOOD), "--task", "grasp")
    assert code == 0 and "ok  valid actions  64 of 64" in shown and "to fix" not in shown
    code, shown = rema(write(tmp_path, "return good(observations) * 1.0"), "--task", "grasp")
    assert code == 3 and "refused  valid actions" in shown
    assert "to fix valid actions: return integers: actions.astype(np.int64)" in shown


def test_the_command_prints_one_object_for_programs(tmp_path: Path) -> None:
    code, shown = rema(write(tmp_path, GOOD), "--task", "push", "--json")
    found = json.loads(shown)
    assert code == 0 and found["ok"] is True and found["tasks"] == ["push"]
    assert set(found) == {"ok", "projected_s", *PolicyReport.__slots__}
    code, shown = rema(str(tmp_path / "mine.py"), "--checkpoint", "none", "--json")
    assert (code, shown) == (2, "")
