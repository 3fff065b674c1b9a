"""Engines are entry points: those of others are found like the built-in ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import pytest
from click.testing import CliRunner

from baselines.rounds.estimate import estimate
from baselines.rounds.plan import load_plan
from evaluator.cli.main import cli
from evaluator.engines import engine_names, make_engine, worker_count
from evaluator.engines.inline import InlineEngine
from evaluator.engines.registry import GROUP
from evaluator.runner import run_evaluation
from rema_data.errors import InputError
from tests.baselines.rounds.fakes import write_plan
from tests.evaluator.fakes import fake_backend, fake_config


class OwnEngine(InlineEngine):
    """An engine of another package, with an address."""

    place = "cluster"
    workers = 5
    made: ClassVar[list[dict[str, Any]]] = []
    open: ClassVar[set[OwnEngine]] = set()

    def __init__(self, factory: str, workers: int | None = None, *, address: str | None = None) -> None:
        super().__init__(factory)
        self.made.append({"workers": workers, "address": address})
        self.open.add(self)

    def close(self) -> None:
        super().close()
        self.open.discard(self)


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package with two engines is installed."""
    folder = tmp_path / "site" / "own_engines-1.0.dist-info"
    folder.mkdir(parents=True)
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: own-engines\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text(f"[{GROUP}]\nown = {__name__}:OwnEngine\nbroken = not_there:Engine\n")
    monkeypatch.syspath_prepend(str(folder.parent))


def test_an_engine_of_another_package_runs_an_evaluation(own: None, fake_home: Path) -> None:
    assert "own" in engine_names() and make_engine("own", address="here:1").workers == 5
    config = fake_config(fake_home / "run", engine="own", address="here:1", episodes=5, audit_share=0.0)
    assert run_evaluation(config, backend=fake_backend()).summary["episodes"] == 5
    assert OwnEngine.made[-1] == {"workers": 2, "address": "here:1"}


def test_no_engine_stays_open(own: None, fake_home: Path) -> None:
    """One on a cluster would keep this process in it: a later engine would use that one, whatever its address."""
    OwnEngine.open.clear()
    assert worker_count("own") == 5
    run_evaluation(fake_config(fake_home / "run", engine="own", episodes=5), backend=fake_backend())
    estimate(load_plan(write_plan(fake_home)), engine="own", backend=fake_backend())
    assert not OwnEngine.open


def test_an_unknown_name_lists_what_is_installed(own: None) -> None:
    with pytest.raises(InputError, match="unknown engine 'dask'") as caught:
        make_engine("dask")
    assert caught.value.hint == "installed: broken, inline, own, process, ray"
    done = CliRunner().invoke(cli, ["evaluate", "random", "--task", "grasp", "--engine", "dask"])
    assert done.exit_code == 2 and "installed: broken, inline, own, process, ray" in done.stderr


def test_an_engine_that_cannot_be_imported(own: None) -> None:
    with pytest.raises(
        InputError, match="'broken' of rema.engines .*own-engines.* cannot be loaded: ModuleNotFoundError"
    ):
        make_engine("broken")


def test_an_address_is_for_an_engine_on_a_cluster() -> None:
    with pytest.raises(InputError, match="this machine alone"):
        make_engine("process", address="auto")
