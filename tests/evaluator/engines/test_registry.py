"""Engines are entry points: those of others are found like the built-in ones."""

from __future__ import annotations

import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, ClassVar

import pytest
from click.testing import CliRunner

from evaluator.cli.main import cli
from evaluator.engines import engine_names, make_engine, worker_count
from evaluator.engines.inline import InlineEngine
from evaluator.engines.registry import BUILT_IN, GROUP
from evaluator.runner import run_evaluation
from rema_data.errors import InputError
from tests.evaluator.fakes import fake_backend, fake_config


class OwnEngine(InlineEngine):
    """An engine of somebody else, with an address."""

    place = "cluster"
    workers = 5
    made: ClassVar[list[dict[str, Any]]] = []

    def __init__(self, factory: str, workers: int | None = None, *, address: str | None = None) -> None:
        super().__init__(factory)
        self.made.append({"workers": workers, "address": address})


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> list[EntryPoint]:
    """What is installed, to be changed."""
    found: list[EntryPoint] = []
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: found if group == GROUP else [])
    return found


def test_the_built_in_engines_are_those_of_the_package() -> None:
    content = tomllib.loads((Path(__file__).resolve().parents[3] / "pyproject.toml").read_text())
    assert content["project"]["entry-points"][GROUP] == BUILT_IN


def test_a_checkout_that_is_not_installed_has_the_built_in_engines(installed: list[EntryPoint]) -> None:
    assert set(engine_names()) == set(BUILT_IN)
    assert isinstance(make_engine("inline"), InlineEngine)


def test_an_engine_of_somebody_else_plays_a_run(installed: list[EntryPoint], fake_home: Path) -> None:
    installed.append(EntryPoint("own", f"{__name__}:OwnEngine", GROUP))
    assert "own" in engine_names() and worker_count("own", address="here:1") == 5
    config = fake_config(fake_home / "run", engine="own", address="here:1", episodes=5, audit_share=0.0)
    assert run_evaluation(config, backend=fake_backend()).summary["episodes"] == 5
    assert OwnEngine.made[-1] == {"workers": 2, "address": "here:1"}


def test_an_unknown_name_lists_what_is_installed(installed: list[EntryPoint]) -> None:
    installed.append(EntryPoint("own", f"{__name__}:OwnEngine", GROUP))
    with pytest.raises(InputError, match="unknown engine 'dask'") as caught:
        make_engine("dask")
    assert caught.value.hint == "installed: inline, own, process, ray"
    done = CliRunner().invoke(cli, ["evaluate", "random", "--task", "grasp", "--engine", "dask"])
    assert done.exit_code == 2 and "installed: inline, own, process, ray" in done.stderr


def test_an_engine_that_cannot_be_imported(installed: list[EntryPoint]) -> None:
    installed.append(EntryPoint("broken", "a_library_that_is_not_there:Engine", GROUP))
    with pytest.raises(InputError, match="broken engine cannot be loaded: No module named"):
        make_engine("broken")


def test_an_address_is_for_an_engine_on_a_cluster() -> None:
    with pytest.raises(InputError, match="this machine alone"):
        make_engine("process", address="auto")
