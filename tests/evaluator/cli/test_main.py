"""The command itself: quick help, version, verbs."""

from __future__ import annotations

import errno
import importlib
import signal
import subprocess
import sys

import click
import pytest
from click.testing import CliRunner

from evaluator.cli.main import VERBS, cli


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_a_module_and_help(verb: str) -> None:
    module, _, attribute = VERBS[verb].target.partition(":")
    assert isinstance(getattr(importlib.import_module(module), attribute), click.Command)
    result = CliRunner().invoke(cli, [verb, "--help"])
    assert result.exit_code == 0 and verb in result.stdout


def test_help_and_version() -> None:
    result = CliRunner().invoke(cli, ["--help"])
    assert all(name in result.stdout and verb.help in result.stdout for name, verb in VERBS.items())
    assert CliRunner().invoke(cli, ["--version"]).stdout.startswith("rema ")
    assert CliRunner().invoke(cli, ["fly"]).exit_code == 2


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys\nfrom evaluator.cli.main import cli\n"
        "try: cli(['--help'], prog_name='rema')\nexcept SystemExit: pass\n"
        "heavy = {'numpy', 'scipy', 'pyarrow', 'pandas', 'torch', 'pybullet', 'rich'} & set(sys.modules)\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (OSError(errno.EMFILE, "Too many open files"), 2, "rema: the system refused: Too many open files"),
        (PermissionError(errno.EACCES, "Permission denied", "x.pt"), 2, "Permission denied: x.pt"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_errors_become_sentences(monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int, words: str) -> None:
    @click.command()
    def evaluate() -> None:
        raise error

    monkeypatch.setattr(importlib.import_module("evaluator.cli.evaluate"), "evaluate", evaluate)
    result = CliRunner().invoke(cli, ["evaluate"])
    assert result.exit_code == code and words in result.stderr and "Traceback" not in result.stderr


@pytest.mark.parametrize(("verb", "end"), [("evaluate", "again to resume"), ("replay", "again")])
def test_what_an_interrupted_verb_does_when_it_is_run_again(
    monkeypatch: pytest.MonkeyPatch, verb: str, end: str
) -> None:
    @click.command()
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(importlib.import_module(f"evaluator.cli.{verb}"), verb, interrupted)
    result = CliRunner().invoke(cli, [verb])
    assert result.exit_code == 130 and result.stderr.endswith(f"run the same command {end}\n")


STOPPED = """
import importlib, os, signal, sys, time
import click
from rema_data import interrupts
@click.command()
def evaluate():
    try:
        for kind in ({kind}, signal.SIGINT, {kind}):
            os.kill(os.getpid(), kind)
        for step in range(99):
            {step}
            interrupts.check()
    finally:
        print("tidied", step, flush=True)
importlib.import_module("evaluator.cli.evaluate").evaluate = evaluate
interrupts.GRACE_S = {grace_s}
sys.argv[1:] = ["evaluate"]
from evaluator.cli.{start}
"""
STARTS = {"start": "start import main; main()", "main": "main import cli; sys.exit(cli())"}


def stopped(
    kind: signal.Signals, step: str, start: str = "start", grace_s: float = 60.0
) -> subprocess.CompletedProcess[str]:
    ordinary = "import signal\nfor kind in (1, 2, 15): signal.signal(kind, signal.SIG_DFL)\n"  # also under nohup
    code = ordinary + STOPPED.format(kind=int(kind), step=step, start=STARTS[start], grace_s=grace_s)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)


@pytest.mark.parametrize(
    ("kind", "code", "start"),
    [(signal.SIGINT, 130, "start"), (signal.SIGTERM, 143, "start"), (signal.SIGHUP, 129, "main")],
)
def test_a_signal_stops_a_verb_between_two_steps_and_the_first_one_decides(
    kind: signal.Signals, code: int, start: str
) -> None:
    done = stopped(kind, "pass", start)
    assert (done.returncode, done.stdout) == (code, "tidied 0\n")
    assert "interrupted" in done.stderr and "Traceback" not in done.stderr


def test_a_step_that_takes_too_long_is_ended() -> None:
    done = stopped(signal.SIGTERM, "time.sleep(60)", grace_s=0.2)
    assert (done.returncode, done.stdout) == (143, "")
    assert "interrupted; run the same command again" in done.stderr and "Traceback" not in done.stderr
