"""`rema evaluate`: arguments, messages, exit codes; the run itself is replaced."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

import evaluator.runner
from evaluator.cli.main import cli
from evaluator.runner import EvaluationConfig, EvaluationResult
from rema_data import errors
from rema_data.progress import Progress


def make_summary(**changes: Any) -> dict[str, Any]:
    """A plausible ``summary.json`` object."""
    summary = {
        "task": "grasp",
        "policy": "random",
        "privileged": False,
        "protocol": "conditional",
        "episodes": 1000,
        "eligible": 1000,
        "successes": 56,
        "success_rate": 0.056,
        "ci95": [0.0434, 0.0721],
        "success_rate_bounds": [0.056, 0.056],
        "failures": {"missed": 800, "blocked": 140, "policy_error": 4},
        "policy_errors": 4,
        "infra_errors": 0,
        "funnel": [],
        "seconds": {"observe": 1.0, "infer": 0.5, "simulate": 8.0, "total": 9.7},
        "episodes_per_second": 103.1,
        "workers": 2,
        "protocol_hash": "p",
        "scenarios_hash": "s",
        "fingerprint": {"pybullet": "3.2.7"},
    }
    return {**summary, **changes}


class Recorder:
    """Stands in for ``run_evaluation``: remembers the configuration, and raises or answers."""

    def __init__(self) -> None:
        self.config: EvaluationConfig | None = None
        self.error: BaseException | None = None
        self.summary: dict[str, Any] = make_summary()

    def __call__(self, config: EvaluationConfig, progress: Progress) -> EvaluationResult:
        self.config = config
        progress.phase("observe", 10)
        progress.advance(10)
        progress.note("resumed at [3/10]")
        progress.phase("simulate", 10)
        if self.error is not None:
            raise self.error
        progress.advance(10)
        return EvaluationResult(config.output, self.summary)


@pytest.fixture
def recorder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Recorder:
    monkeypatch.chdir(tmp_path)
    made = Recorder()
    monkeypatch.setattr(evaluator.runner, "run_evaluation", made)
    return made


def rema(*arguments: str) -> Result:
    return CliRunner().invoke(cli, arguments, prog_name="rema")


def test_defaults(recorder: Recorder) -> None:
    result = rema("evaluate", "random", "--task", "grasp")
    assert result.exit_code == 0, result.stderr
    config = recorder.config
    assert config is not None
    assert (config.episodes, config.protocol, config.split, config.engine) == (10_000, "conditional", "test", "process")
    assert config.output == Path("runs/random-grasp-conditional")
    assert (config.policy.name, config.checkpoint, config.workers) == ("random", None, None)


def test_the_result_is_on_stdout_and_the_progress_on_stderr(recorder: Recorder) -> None:
    recorder.summary = make_summary(infra_errors=2, success_rate_bounds=[0.0559, 0.0579])
    result = rema("evaluate", "random", "--task", "grasp")
    for words in (
        "5.6 % [4.3, 7.2]",
        "missed",
        "800",
        "runs/random-grasp-conditional",
        "103.1 episodes/s",
        "5.6 .. 5.8 %",
    ):
        assert words in result.stdout
    assert "resumed at [3/10]" in result.stderr and "observe: 10/10" in result.stderr
    assert "resumed" not in result.stdout


def test_the_funnel_of_an_end_to_end_run(recorder: Recorder) -> None:
    funnel = [{"step": 0, "attempted": 1000, "succeeded": 600}, {"step": 1, "attempted": 600, "succeeded": 56}]
    recorder.summary = make_summary(protocol="end-to-end", funnel=funnel, policy="my_policy")
    result = rema("evaluate", "random", "--task", "grasp_push", "--protocol", "end-to-end")
    assert "600 of 1,000 that reached it, 60.0 %" in result.stdout


def test_what_there_is_to_trust_a_result_is_shown(recorder: Recorder) -> None:
    audit = {"actions": 100, "action_flips": 3, "action_flips_ci95": [0.006, 0.085]}
    audit |= {"outcomes": 100, "outcome_flips": 0, "outcome_flips_ci95": [0.0, 0.036], "lost": 2}
    look = {"verdict": "better", "against": "scripted", "pairs": 200, "difference_interval": [0.02, 0.31]}
    recorder.summary = make_summary(isolation="L2", audit=audit, stopped_early=look, unfinished=5)
    shown = " ".join(rema("evaluate", "random", "--task", "grasp").stdout.split())
    for words in (
        "sandbox L2",
        "100 actions re-run: 3 differed (95 % upper bound 8.5 %)",
        "100 outcomes simulated again: 0 differed (95 % upper bound 3.6 %)",
        "2 could not be repeated",
        "better than scripted on 200 scenarios: the difference is in +2.0 .. +31.0 points",
        "no rank",
        "5 episodes: this run is partial",
    ):
        assert words in shown, words


def test_a_part_of_a_run_behind_a_wrapper(recorder: Recorder) -> None:
    result = rema("evaluate", "random", "--task", "grasp", "--shard", "2/5", "--sandbox", "env A=1", "--output", "part")
    assert result.exit_code == 0, result.stderr
    assert recorder.config is not None and str(recorder.config.shard) == "2/5"
    assert recorder.config.sandbox == "env A=1"


def test_nothing_eligible(recorder: Recorder) -> None:
    recorder.summary = make_summary(eligible=0, successes=0, success_rate=None, ci95=None, failures={}, infra_errors=9)
    result = rema("evaluate", "random", "--task", "grasp")
    assert result.exit_code == 0 and "no eligible episode" in result.stdout


def test_json_is_alone_on_stdout(recorder: Recorder) -> None:
    result = rema("evaluate", "random", "--task", "grasp", "--json", "--split", "val", "--output", "here")
    assert json.loads(result.stdout) == recorder.summary
    assert recorder.config is not None and recorder.config.output == Path("here")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("random", "--task", "fly"), "'fly' is not one of 'grasp'"),
        (("random",), "Missing option '--task'"),
        (("random", "--task", "grasp", "--episodes", "0"), "0 is not in the range x>=1"),
        (("random", "--task", "grasp", "--workers", "0"), "x>=1"),
        (("random", "--task", "grasp", "--checkpoint", "none.pt"), "checkpoint none.pt does not exist"),
        (("nobody", "--task", "grasp"), "random        Uniform over the valid actions. (random)"),
        (("none.py", "--task", "grasp"), "policy file none.py does not exist"),
    ],
)
def test_bad_input_is_a_sentence_and_exit_code_2(recorder: Recorder, arguments: tuple[str, ...], words: str) -> None:
    result = rema("evaluate", *arguments)
    assert result.exit_code == 2
    assert words in result.stderr and "Traceback" not in result.stderr and result.stdout == ""
    assert recorder.config is None


@pytest.mark.parametrize(
    ("kind", "code"),
    [
        (errors.InputError, 2),
        (errors.RunMismatchError, 2),
        (errors.StorageError, 2),
        (errors.SubmissionError, 3),
        (errors.PolicyFailureError, 4),
        (errors.InfrastructureError, 5),
        (errors.IntegrityError, 6),
    ],
)
def test_errors_end_in_their_exit_code(recorder: Recorder, kind: type[errors.RemaError], code: int) -> None:
    recorder.error = kind("this is wrong", hint="fix it so")
    result = rema("evaluate", "random", "--task", "grasp")
    assert result.exit_code == code
    assert result.stderr.endswith("rema: this is wrong\nfix it so\n") and result.stdout == ""


def test_a_bug_keeps_its_traceback(recorder: Recorder) -> None:
    recorder.error = ZeroDivisionError("a bug")
    result = rema("evaluate", "random", "--task", "grasp")
    assert result.exit_code == 1 and isinstance(result.exception, ZeroDivisionError)
