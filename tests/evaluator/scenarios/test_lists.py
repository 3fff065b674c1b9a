"""Frozen lists: exact round trips, stable bytes, and no list that is not the one in the manifest."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from evaluator.scenarios import VERSION, encode_list, load_list, manifest_path, scenario_id, table, update_manifest
from evaluator.scenarios.suites import cells_of
from rema_data.errors import InputError, IntegrityError, MissingFileError
from rema_data.repair import restore
from rema_data.schema import TASKS
from rema_data.variation import compact
from tests.evaluator.fakes import fake_scenario, write_fake_list
from tests.evaluator.runs import write_suite


@pytest.mark.parametrize("task", TASKS)
def test_round_trip_is_exact(task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_fake_list(tmp_path, task, 30)
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path))
    loaded = load_list(task)
    assert loaded.scenarios == tuple(fake_scenario(task, index) for index in range(30))
    assert scenario_id(loaded.version, loaded.scenarios[7]) == f"{VERSION}/{task}/test/00007"


def test_missing_tools_stay_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bare = replace(fake_scenario("grasp_push", 0), grips=())
    payload = encode_list([bare])
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path))
    manifest = manifest_path(VERSION)
    folder = manifest.parent
    folder.mkdir(parents=True)
    (folder / "a.parquet").write_bytes(payload)
    import hashlib

    digest = hashlib.sha256(payload).hexdigest()
    update_manifest(manifest, VERSION, "grasp_push/test", file="a.parquet", sha256=digest, count=1, seed_domain="x")
    assert load_list("grasp_push").scenarios == (bare,)


def test_bytes_are_a_function_of_the_scenarios() -> None:
    scenarios = [fake_scenario("grasp_grasp_push", index) for index in range(50)]
    assert encode_list(scenarios) == encode_list(list(scenarios))


def test_damage_is_noticed(fake_home: Path) -> None:
    path = fake_home / "manifests" / "scenarios" / VERSION / "grasp_test.parquet"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(IntegrityError, match="sha256"):
        load_list("grasp")


def test_a_missing_list_is_reported_with_its_fix(fake_home: Path) -> None:
    path = fake_home / "manifests" / "scenarios" / VERSION / "grasp_test.parquet"
    path.unlink()
    with pytest.raises(MissingFileError) as caught:
        load_list("grasp")
    assert caught.value.hint == restore(path)
    with pytest.raises(InputError, match="grasp_grasp_push/test"):
        load_list("push")
    with pytest.raises(MissingFileError, match="v9"):
        load_list("grasp_grasp_push", version="v9")


def test_a_manifest_has_one_version(fake_home: Path) -> None:
    path = fake_home / "manifests" / "scenarios" / VERSION / "manifest.json"
    with pytest.raises(InputError, match="immutable"):
        update_manifest(path, "v9", "push/test", file="f", sha256="0", count=1, seed_domain="x")
    assert json.loads(path.read_text())["version"] == VERSION


@pytest.mark.parametrize("text", ["{", "{}", "[]"])
def test_a_damaged_manifest_is_named(fake_home: Path, text: str) -> None:
    (fake_home / "manifests" / "scenarios" / VERSION / "manifest.json").write_text(text)
    with pytest.raises(IntegrityError, match="manifest"):
        load_list("grasp")


def test_a_manifest_whose_file_has_too_long_a_name(fake_home: Path) -> None:
    path = fake_home / "manifests" / "scenarios" / VERSION / "manifest.json"
    content = json.loads(path.read_text())
    content["lists"]["grasp/test"]["file"] += 300 * "x"
    path.write_text(json.dumps(content))
    with pytest.raises(IntegrityError, match=r"grasp/test: file is .* at most 200 characters"):
        load_list("grasp")


def test_a_manifest_of_another_version_is_refused(fake_home: Path) -> None:
    manifest = manifest_path(VERSION)
    manifest.write_text(manifest.read_text().replace(f'"{VERSION}"', '"v0"'))
    with pytest.raises(IntegrityError, match="says that it is of version 'v0'"):
        load_list("grasp")


def stored(content: dict[str, Any]) -> str:
    """As a list stores a variation."""
    return json.dumps(content, separators=(",", ":"))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"level": "one"}, "level: Input should be a valid integer"),
        ({"level": "1"}, "it is not written as it would be stored"),
        ({"wind_m_s": 1.0}, "it is not written as it would be stored"),
        ({"mass_offset_m": [float("nan"), 0.0]}, "NaN is no quantity"),
        ({"sense": {"seed": 1, "noise_m": "much"}}, "sense.noise_m"),
        ({"others": [{"x_m": 1.0}]}, "others.0.spec"),
    ],
)
def test_a_change_that_is_none_is_refused(
    fake_home: Path, monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any], words: str
) -> None:
    write_suite(fake_home / "manifests")
    assert cells_of(load_list("grasp", "test", "tough-v1"))
    monkeypatch.setattr(table, "variation_text", lambda variation: stored(compact(variation) | changes))
    write_suite(fake_home / "manifests", "odd-v1")
    with pytest.raises(IntegrityError, match=re.escape(words)):
        load_list("grasp", "test", "odd-v1")


def test_an_axis_that_is_not_known_here_is_named(fake_home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "variation_text", lambda variation: stored(compact(variation) | {"axis": "gravity"}))
    write_suite(fake_home / "manifests", "odd-v1")
    with pytest.raises(IntegrityError, match="an axis that is not known here: 'gravity'"):
        cells_of(load_list("grasp", "test", "odd-v1"))


def test_lists_that_cannot_be_written() -> None:
    with pytest.raises(InputError):
        encode_list([])
    with pytest.raises(InputError, match="scenario 1"):
        encode_list([fake_scenario("grasp", 0), fake_scenario("grasp", 2)])
    with pytest.raises(InputError, match="scenario 0"):
        encode_list([replace(fake_scenario("grasp_push", 0), placements=())])


def test_ten_thousand_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_fake_list(tmp_path, "grasp_push", 10_000)
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path))
    assert [one.index for one in load_list("grasp_push").scenarios] == list(range(10_000))
