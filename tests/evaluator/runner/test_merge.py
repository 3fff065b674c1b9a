"""Merged shards are the run that was never divided; what is not a shard of it is refused by name."""

from __future__ import annotations

import errno
import json
import shutil
from collections.abc import Callable, Iterable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from filelock import FileLock

from evaluator.cli.main import cli
from evaluator.engines.base import load_attribute
from evaluator.run.folder import RunFolder
from evaluator.run.plan import Plan
from evaluator.run.reading import read_run
from evaluator.run.records import Ledger, _line
from evaluator.runner import merge, run_evaluation
from evaluator.runner.audit import repeats, seed_of
from evaluator.runner.finalize import seal_run, write_tables
from evaluator.runner.merge import merge_runs
from evaluator.runner.shards import RunShard
from evaluator.scenarios import load_list
from rema_data.errors import InputError, IntegrityError, MissingFileError, RunMismatchError
from tests.evaluator.fakes import FakePolicyProcess, fake_backend, fake_config, write_fake_list

LONG = "grasp_grasp_push"
EPISODES, COUNT, BATCH = 200, 3, 16
SAME = ("results.parquet", "actions.bin")


def cut(whole: Path, folder: Path, indices: Iterable[int], shard: str) -> Path:
    """The folder that a run would have left that played these scenarios alone."""
    chosen = set(indices)
    folder.mkdir(parents=True)
    header = json.loads((whole / "run.json").read_text())
    for segment in header["segments"]:
        segment["shard"] = shard
    (folder / "run.json").write_text(json.dumps(header))
    for journal in (whole / "records").rglob("*.jsonl"):
        lines = journal.read_bytes().splitlines(keepends=True)
        target = folder / journal.relative_to(whole)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(b"".join(line for line in lines if json.loads(line)[1]["index"] in chosen))
    seal(folder, header)
    return folder


def seal(folder: Path, header: dict[str, Any]) -> None:
    """Write the tables that follow from the records of a run, and seal it."""
    identity = header["identity"]
    scenarios = load_list(identity["task"])
    plan = Plan(scenarios.scenarios[: header["episodes"]], identity["task"], identity["protocol"])
    with (
        RunFolder.locked(folder, identity, header["episodes"]) as whole,
        closing(Ledger(whole.records, whole.segment)) as ledger,
    ):
        seal_run(whole, plan, ledger, write_tables(whole, plan, scenarios, ledger), None)


def table(folder: Path) -> list[bytes]:
    return [(folder / name).read_bytes() for name in SAME]


@pytest.fixture(scope="module")
def divided(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a whole run and of its three shards, only to be read."""
    folder = tmp_path_factory.mktemp("divided")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("REMA_MANIFESTS", str(folder / "manifests"))
        patch.setenv("REMA_HOME", str(folder / "home"))
        write_fake_list(folder / "manifests", LONG, 300)
        config = fake_config(folder / "whole", task=LONG, protocol="end-to-end", batch_size=BATCH, engine="inline")
        run_evaluation(config, backend=fake_backend())
        for number in range(1, COUNT + 1):
            shard = RunShard(number, COUNT)
            cut(folder / "whole", folder / f"shard{number}", shard.indices(EPISODES, BATCH), str(shard))
    return folder


def _inline(simulate: Callable[..., None], *arguments: Any, **named: Any) -> None:
    simulate(*arguments, **{**named, "engine": "inline"})


@pytest.fixture(autouse=True)
def _fake_world(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a process for the sample and one for the fingerprint."""
    monkeypatch.setattr(merge, "default_backend", fake_backend)
    monkeypatch.setattr(merge, "call_in_child", lambda target: load_attribute(target)())
    monkeypatch.setattr(merge, "simulate_jobs", partial(_inline, merge.simulate_jobs))


@pytest.fixture
def whole(divided: Path) -> Path:
    return divided / "whole"


@pytest.fixture
def shards(divided: Path, fake_home: Path) -> list[Path]:
    """Three shards of it, to be changed."""
    return [shutil.copytree(divided / f"shard{number}", fake_home / f"shard{number}") for number in range(1, COUNT + 1)]


def test_merged_shards_have_the_bytes_of_the_whole_run(whole: Path, shards: list[Path], fake_home: Path) -> None:
    result = merge_runs(shards[::-1], fake_home / "merged")
    assert table(fake_home / "merged") == table(whole)
    before = json.loads((whole / "summary.json").read_text())
    differ = {name for name in before if before[name] != result.summary[name]}
    assert differ <= {"seconds", "episodes_per_second", "segments", "audit"}
    assert result.summary["audit"]["outcomes"] > before["audit"]["outcomes"]  # the sample, besides the shards' audits
    assert result.summary["audit"]["actions"] > 0


def test_a_merged_run_is_sealed_and_goes_on_like_any_other(shards: list[Path], fake_home: Path) -> None:
    merge_runs(shards, fake_home / "merged")
    assert read_run(fake_home / "merged").seal_state == "whole"
    before = table(fake_home / "merged")
    process = FakePolicyProcess()
    config = fake_config(fake_home / "merged", task=LONG, protocol="end-to-end", batch_size=BATCH)
    run_evaluation(config, backend=fake_backend(process))
    assert process.asked == 0
    assert table(fake_home / "merged") == before


@pytest.mark.parametrize("file", ["results.parquet", "actions.bin", "summary.json", "run.json"])
def test_a_shard_that_is_not_what_was_sealed_is_refused(shards: list[Path], fake_home: Path, file: str) -> None:
    content = (shards[1] / file).read_bytes()
    edited = content.replace(b'"unfinished"', b'"Unfinished"').replace(b'"shuffled"', b'"Shuffled"')
    (shards[1] / file).write_bytes(edited if edited != content else content[:-9] + b"x" + content[-8:])
    with pytest.raises(IntegrityError, match="shard2 is refused"):
        merge_runs(shards, fake_home / "merged")
    assert not (fake_home / "merged").exists()


def false_outcomes(shard: Path) -> None:
    """Give failures of a shard, in its records and in the repeats of its audit, another label and a new checksum."""
    for journal in (shard / "records").rglob("outcomes-*.jsonl"):
        lines = []
        for line in journal.read_bytes().splitlines():
            row = json.loads(line)[1]
            if not row["outcome"]["success"]:
                row["outcome"].update(failure="slipped")
            lines.append(_line(row))
        journal.write_bytes(b"".join(lines))
    seal(shard, json.loads((shard / "run.json").read_text()))


def test_a_shard_with_false_outcomes_is_found_by_the_sample(
    shards: list[Path], fake_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("evaluator.runner.merge.AUDIT_SHARE", 1.0)  # a small sample may miss those of one shard
    false_outcomes(shards[1])
    with pytest.raises(IntegrityError, match="have another outcome than recorded") as caught:
        merge_runs(shards, fake_home / "merged")
    assert str(shards[1]) in caught.value.message and not (fake_home / "merged").exists()


def test_another_simulator_only_counts(shards: list[Path], fake_home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REMA_FAKE_PARAMETERS", "other")
    monkeypatch.setattr("evaluator.runner.merge.AUDIT_SHARE", 1.0)
    merge_runs(shards, fake_home / "merged")
    before = json.loads((shards[0].parent / "merged" / "summary.json").read_text())["audit"]
    assert before["outcome_flips"] == 0
    false_outcomes(shards[1])
    with pytest.raises(IntegrityError, match="have another outcome"):
        merge_runs(shards, fake_home / "false")


def test_the_sample_cannot_be_known_before_the_shards_are_sealed(shards: list[Path]) -> None:
    """The same shards give the same sample in any order; another seal or another row gives another one."""
    scenarios = Plan(load_list(LONG).scenarios[:EPISODES], LONG, "end-to-end")
    ledger = Ledger(shards[0] / "records", 9)

    def sample(*sealed: bytes) -> list[int]:
        return [repeat.index for repeat in repeats(scenarios, ledger, 0.1, seed_of(*sealed))]

    assert sample(b"a", b"b") == sample(b"a", b"b")
    assert sample(b"a", b"b") != sample(b"a", b"c") and sample(b"a") != sample(b"b")


def test_shards_are_left_as_they_are(shards: list[Path], fake_home: Path) -> None:
    def content() -> dict[Path, bytes]:
        return {
            path: path.read_bytes()
            for shard in shards
            for path in shard.rglob("*")
            if path.name != ".lock" and path.is_file()
        }

    before = content()
    merge_runs(shards, fake_home / "merged")
    assert content() == before


def test_a_missing_shard_is_named(shards: list[Path], fake_home: Path) -> None:
    with pytest.raises(InputError, match=r"no folder is of shard 2/3"):
        merge_runs([shards[0], shards[2]], fake_home / "merged")
    assert not list(fake_home.glob("*merg*"))


def test_a_shard_that_is_not_finished(shards: list[Path], fake_home: Path) -> None:
    journal = next((shards[1] / "records").glob("outcomes-*.jsonl"))
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[:-3]))
    with pytest.raises(InputError, match="3 of 200 episodes are in no shard, or not finished"):
        merge_runs(shards, fake_home / "merged")


def test_shards_that_overlap(shards: list[Path], fake_home: Path) -> None:
    shutil.copytree(shards[1], fake_home / "copy")
    with pytest.raises(InputError, match=f"scenario 64 is both in {shards[1]} and in {fake_home / 'copy'}"):
        merge_runs([*shards, fake_home / "copy"], fake_home / "merged")
    with pytest.raises(InputError, match="given twice"):
        merge_runs([*shards, shards[1]], fake_home / "merged")


@pytest.mark.parametrize(
    ("field", "value"),
    [("policy_digest", "other"), ("fingerprint", {"pybullet": "1"}), ("scenarios_hash", "x"), ("protocol_hash", "y")],
)
def test_shards_of_other_runs(shards: list[Path], fake_home: Path, field: str, value: Any) -> None:
    path = shards[2] / "run.json"
    header = json.loads(path.read_text())
    header["identity"][field] = value
    path.write_text(json.dumps(header))
    with pytest.raises(RunMismatchError, match=f"the {field} of the first is"):
        merge_runs(shards, fake_home / "merged")


def test_shards_of_another_number_of_episodes(shards: list[Path], fake_home: Path) -> None:
    path = shards[2] / "run.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "episodes": 300}))
    with pytest.raises(RunMismatchError, match="the episodes of the first is 200"):
        merge_runs(shards, fake_home / "merged")


def test_a_list_that_has_changed_since(shards: list[Path], fake_home: Path) -> None:
    for shard in shards:
        path = shard / "run.json"
        header = json.loads(path.read_text())
        header["identity"]["scenarios_hash"] = "x"
        path.write_text(json.dumps(header))
    with pytest.raises(RunMismatchError, match="another scenario list than the ones here: x"):
        merge_runs(shards, fake_home / "merged")


def test_damaged_records(shards: list[Path], fake_home: Path) -> None:
    journal = next((shards[1] / "records").glob("outcomes-*.jsonl"))
    lines = journal.read_bytes().splitlines(keepends=True)
    lines[4] = lines[4].replace(b"true", b"True").replace(b"false", b"False")
    journal.write_bytes(b"".join(lines))
    with pytest.raises(IntegrityError, match="line 5 is damaged"):
        merge_runs(shards, fake_home / "merged")


def test_a_shard_that_is_being_written(shards: list[Path], fake_home: Path) -> None:
    with FileLock(shards[0] / ".lock"), pytest.raises(InputError, match=f"another process is writing in {shards[0]}"):
        merge_runs(shards, fake_home / "merged")


def test_an_output_that_is_there(shards: list[Path], whole: Path, fake_home: Path) -> None:
    before = table(whole)
    with pytest.raises(InputError, match="exists already"):
        merge_runs(shards, whole)
    assert table(whole) == before
    (fake_home / "empty").mkdir()
    merge_runs(shards, fake_home / "empty")


def test_no_run_and_nothing(fake_home: Path) -> None:
    with pytest.raises(MissingFileError, match="holds no run"):
        merge_runs([fake_home / "nothing"], fake_home / "merged")
    with pytest.raises(InputError, match="nothing to merge"):
        merge_runs([], fake_home / "merged")


def test_the_verb(whole: Path, shards: list[Path], fake_home: Path) -> None:
    words = ["merge", *map(str, shards), "--output", str(fake_home / "merged")]
    said = CliRunner().invoke(cli, [*words, "--json"], prog_name="rema")
    assert said.exit_code == 0, said.stderr
    assert json.loads(said.stdout) == json.loads((fake_home / "merged" / "summary.json").read_text())
    again = CliRunner().invoke(cli, words, prog_name="rema")
    assert again.exit_code == 2 and "--output" in again.stderr
    shown = CliRunner().invoke(cli, [*words[:-1], str(fake_home / "other")], prog_name="rema")
    assert shown.exit_code == 0 and "run folder" in shown.stdout


@pytest.mark.parametrize("task", ["grasp", LONG])
def test_divided_runs(task: str, fake_home: Path) -> None:
    changes = {"task": task, "protocol": "end-to-end", "batch_size": BATCH, "engine": "inline", "audit_share": 0.0}
    run_evaluation(fake_config(fake_home / "whole", **changes), backend=fake_backend())
    folders = []
    for number in range(1, COUNT + 1):
        shard = RunShard(number, COUNT)
        process = FakePolicyProcess()
        config = fake_config(fake_home / f"shard{number}", shard=shard, **changes)
        summary = run_evaluation(config, backend=fake_backend(process)).summary
        size = len(shard.indices(EPISODES, BATCH))
        assert summary["eligible"] == size and summary["unfinished"] == EPISODES - size
        folders.append(fake_home / f"shard{number}")
    with pytest.raises(InputError, match=r"no folder is of shard 1/3"):
        merge_runs(folders[1:], fake_home / "merged")
    merge_runs(folders, fake_home / "merged")
    assert table(fake_home / "merged") == table(fake_home / "whole")


def test_a_shard_that_was_stopped_before_its_end(shards: list[Path], fake_home: Path) -> None:
    """All its scenarios have results, but what is repeated was not."""
    header = json.loads((shards[1] / "run.json").read_text())
    del header["seal"]
    (shards[1] / "run.json").write_text(json.dumps(header))
    with pytest.raises(InputError, match="shard2 has no seal") as caught:
        merge_runs(shards, fake_home / "merged")
    assert "--shard 2/3 --batch-size 16" in caught.value.hint and not (fake_home / "merged").exists()


def test_shards_on_a_disk_that_may_not_be_written(
    shards: list[Path], fake_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(lock: FileLock) -> None:
        if Path(lock.lock_file).parent in shards:
            raise OSError(errno.EROFS, "Read-only file system", lock.lock_file)
        acquire(lock)

    acquire = FileLock._acquire
    monkeypatch.setattr(FileLock, "_acquire", refuse)
    assert merge_runs(shards, fake_home / "merged").summary["unfinished"] == 0
