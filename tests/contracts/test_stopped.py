"""Work that is stopped at any look at the flag leaves nothing half-written, and the same call has the same bytes.

The signals themselves are in ``benchmarks/signals.py``; here a flag is up from the n-th look on.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest

from baselines.rounds.collect import collect
from baselines.rounds.plan import load_plan
from baselines.tae.network import Architecture
from baselines.train.config import TrainingConfig
from baselines.train.loop import train
from evaluator.engines.base import load_attribute
from evaluator.runner import run_evaluation
from evaluator.runner.merge import merge_runs
from evaluator.runner.shards import RunShard
from rema_data import interrupts
from rema_data.convert import export_release, import_release
from rema_data.download import download
from rema_data.loader.build import open_cache
from rema_data.loader.release import Release
from rema_data.release.folder import ReleaseFolder
from rema_data.release.registry import register
from rema_data.testing import make_release
from tests.baselines.rounds.fakes import write_plan
from tests.evaluator.fakes import fake_backend, fake_config, fake_fingerprint, write_fake_list

SIGTERM = 15
Work = Callable[[Path], object]


class Flag:
    """A listener that a signal reaches before the ``look``-th look."""

    def __init__(self, look: int | None) -> None:
        self.looks, self._look = 0, look

    @property
    def number(self) -> int | None:
        self.looks += 1
        return None if self._look is None or self.looks < self._look else SIGTERM


def files(folder: Path) -> dict[str, str]:
    """Every file and its sha256, but those that are locks, or differ from run to run."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in ("run.json", "summary.json", "timings.parquet")
        if path.suffix not in (".lock", ".jsonl") and path.name != ".lock"
    }


@pytest.fixture(scope="session")
def release(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    """Ten episodes. Only to be read."""
    return make_release(tmp_path_factory.mktemp("stopped"), tasks=("push",), episodes=8)


@pytest.fixture(autouse=True)
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty home, and manifests with one short list and no release."""
    (tmp_path / "manifests" / "datasets").mkdir(parents=True)
    (tmp_path / "manifests" / "datasets" / "index.json").write_text('{"releases": []}')
    write_fake_list(tmp_path / "manifests", "grasp", 40)
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    for module in ("evaluator.runner.run", "baselines.rounds.collect"):  # how often a wait looks depends on the machine
        monkeypatch.setattr(f"{module}.call_in_child", lambda target: fake_fingerprint())


@pytest.fixture
def exporting(release: ReleaseFolder) -> Work:
    return lambda folder: export_release(release, folder)


@pytest.fixture
def importing(release: ReleaseFolder, tmp_path: Path) -> Work:
    export_release(release, tmp_path / "exported")
    return lambda folder: import_release([tmp_path / "exported"], folder)


@pytest.fixture
def downloading(release: ReleaseFolder, monkeypatch: pytest.MonkeyPatch) -> Work:
    register(release.manifest)

    def work(folder: Path) -> None:
        monkeypatch.setenv("REMA_HOME", str(folder))
        download(release.manifest.name, sources=[release.root], jobs=1)

    return work


@pytest.fixture(autouse=True)
def _calls_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Waiting for a child looks at the flag as often as there is time: here the number of looks is to be the same."""
    for module in ("evaluator.runner.run", "evaluator.runner.merge", "baselines.rounds.collect"):
        monkeypatch.setattr(import_module(module), "call_in_child", lambda target: load_attribute(target)())
    quiet = SimpleNamespace(check=lambda: None, POLL_S=interrupts.POLL_S)  # Git, and what looks into HDF5 files
    monkeypatch.setattr("rema_data.commands.interrupts", quiet)


@pytest.fixture
def decoding(release: ReleaseFolder) -> Work:
    return lambda folder: open_cache(release, release.blocks(), folder)


@pytest.fixture
def evaluating(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Work:
    def work(folder: Path) -> None:
        monkeypatch.setenv("REMA_HOME", str(tmp_path / f"home-{folder.name}"))  # nothing is observed yet
        config = fake_config(folder, episodes=40, batch_size=8, engine="inline", audit_share=0.0)
        run_evaluation(config, backend=fake_backend())

    return work


@pytest.fixture
def merging(tmp_path: Path) -> Work:
    shards = [tmp_path / "shard1", tmp_path / "shard2"]
    for number, shard in enumerate(shards, 1):
        config = fake_config(
            shard, episodes=40, batch_size=8, engine="inline", audit_share=0.0, shard=RunShard(number, 2)
        )
        run_evaluation(config, backend=fake_backend())
    return lambda folder: merge_runs(shards, folder / "whole", engine="inline", backend=fake_backend())


@pytest.fixture
def collecting(tmp_path: Path) -> Work:
    plan = load_plan(write_plan(tmp_path))
    return lambda folder: collect(plan, folder, engine="inline", backend=fake_backend(), chunk_episodes=5)


@pytest.fixture
def training(release: ReleaseFolder, tmp_path: Path) -> Work:
    opened = Release(release, cache=tmp_path / "decoded")
    _ = opened.cache.maps
    config = TrainingConfig(
        "push", ("push",), updates=4, validate_every=2, on_empty="renormalise", architecture=Architecture(width=4)
    )
    return lambda folder: train(opened, config, folder, "push")


VERBS = ["exporting", "importing", "downloading", "decoding", "evaluating", "merging", "collecting", "training"]


@pytest.mark.parametrize("verb", VERBS)
def test_stopped_work_is_done_by_the_same_call(
    verb: str, tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    work: Work = request.getfixturevalue(verb)
    flag = Flag(None)
    with monkeypatch.context() as patch:
        patch.setattr(interrupts, "_listener", flag)
        work(tmp_path / "reference")
    wanted = files(tmp_path / "reference")
    assert flag.looks > 2 and wanted
    wanted_looks = flag.looks
    for look in (1 + wanted_looks // 3, wanted_looks):
        folder = tmp_path / f"stopped-{look}"
        flag = Flag(look)
        with monkeypatch.context() as patch:
            patch.setattr(interrupts, "_listener", flag)
            with suppress(interrupts.Interrupted):
                work(folder)
                # A wait looks as often as there is time: the last look of the first time may not come again.
                assert flag.looks < look == wanted_looks
        if folder.exists() and verb in ("exporting", "importing", "decoding", "merging"):
            assert files(folder).items() <= wanted.items()
        work(folder)
        assert files(folder) == wanted
        shutil.rmtree(folder)
