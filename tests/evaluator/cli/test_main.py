"""The command itself: quick help, version, verbs."""

from __future__ import annotations

import importlib
import subprocess
import sys

import click
import pytest
from click.testing import CliRunner

from evaluator.cli.main import VERBS, cli


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_a_module_and_help(verb: str) -> None:
    assert isinstance(getattr(importlib.import_module(f"evaluator.cli.{verb}"), verb), click.Command)
    result = CliRunner().invoke(cli, [verb, "--help"])
    assert result.exit_code == 0 and verb in result.stdout


def test_help_and_version() -> None:
    result = CliRunner().invoke(cli, ["--help"])
    assert all(line in result.stdout for verb in VERBS.items() for line in verb)
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
