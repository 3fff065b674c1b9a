"""A scene of the validation split or of a frozen list must not be trained on."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
from hypothesis import given
from hypothesis import strategies as st

from rema_data.release.folder import ReleaseFolder
from rema_data.store.block import BlockKey
from rema_data.store.tables import to_parquet
from rema_data.verify import verify
from rema_data.verify.leakage import frozen_lists, read_frozen, scene_keys
from tests.rema_data.verify.damage import GRASP_TRAIN, location, parquet, reseal, with_value

SCENE = ("shape", "length_m", "width_m", "arm_m", "height_m", "x_m", "y_m", "yaw_rad")
PUSH_VAL = BlockKey(1, "push", "val")


def steps_of(release: ReleaseFolder, key: BlockKey) -> pa.Table:
    return pq.read_table(release.root / location(release, key, "steps.parquet"))


def write_list(manifests: Path, scenes: pa.Table, step: int, name: str = "grasp_push_test") -> Path:
    """A frozen list in which the scenes are the objects of one of two steps."""
    path = manifests / "scenarios" / "v7" / f"{name}.parquet"
    path.parent.mkdir(parents=True, exist_ok=True)
    columns = {"index": pa.array(range(len(scenes)))}
    for number in range(2):
        for part in SCENE:
            values = scenes[f"target_{part}"]
            columns[f"object{number}_{part}"] = values if number == step else pa.nulls(len(scenes), values.type)
    path.write_bytes(parquet(pa.table(columns)))
    return path


def test_scene_of_a_frozen_list(release: ReleaseFolder, manifests: Path) -> None:
    """At any step of the frozen scenario."""
    write_list(manifests, steps_of(release, GRASP_TRAIN).slice(4, 3), step=1)
    report = verify(release)
    assert report.checked["frozen_scenes"] == 4  # the empty objects are one
    (finding,) = report.findings
    assert finding.kind == "leakage"
    assert finding.file == str(release.root / location(release, GRASP_TRAIN, "steps.parquet"))
    assert finding.where == "3 rows: 4, 5, 6"
    assert finding.detail == "the scene occurs in a frozen scenario list: v7/grasp_push/test/00000"


def test_other_numbers_are_another_scene(release: ReleaseFolder, manifests: Path) -> None:
    scenes = steps_of(release, GRASP_TRAIN).slice(4, 1)
    for part in SCENE[1:]:
        name = f"target_{part}"
        moved = with_value(scenes, name, 0, scenes[name][0].as_py() + 1e-9)
        write_list(manifests, moved, step=0, name=f"{part.replace('_', '')}_val")
    report = verify(release)
    assert report.ok and report.checked["frozen_scenes"] == 8


def test_scene_of_the_training_split_in_the_validation_split(release: ReleaseFolder) -> None:
    """In any task."""
    trained, place = steps_of(release, GRASP_TRAIN), location(release, PUSH_VAL, "steps.parquet")
    table = steps_of(release, PUSH_VAL)
    for part in SCENE:
        table = with_value(table, f"target_{part}", 1, trained[f"target_{part}"][5].as_py())
    (finding,) = verify(reseal(release, {place: to_parquet(table)})).findings
    assert (finding.kind, finding.file, finding.where) == ("leakage", str(release.root / place), "row 1")
    assert f"{GRASP_TRAIN.path}/steps.parquet, row 5" in finding.detail


def test_unreadable_list(release: ReleaseFolder, manifests: Path) -> None:
    path = write_list(manifests, steps_of(release, GRASP_TRAIN), step=0)
    path.write_bytes(b"nothing")
    (finding,) = verify(release).findings
    assert (finding.kind, finding.file, finding.fix) == (
        "table",
        str(path),
        f"copy {path} again from where it came from",
    )


def test_the_frozen_lists_of_the_repository_are_all_read() -> None:
    root = Path(__file__).resolve().parents[3] / "manifests"
    paths = frozen_lists(root)
    assert {path.stem for path in paths} >= {"grasp_test", "grasp_val", "grasp_grasp_push_test"}
    scenes = read_frozen(root / "scenarios" / "v1" / "grasp_push_val.parquet")
    assert len(scenes) == 2 * 2_000
    assert "v1/grasp_push/val/01999" in scenes.values()


@given(st.lists(st.sampled_from([0.0, -0.0, 1.0, 1.0 + 2**-52]), min_size=7, max_size=7), st.sampled_from("ILT"))
def test_equal_numbers_are_equal_keys(numbers: list[float], shape: str) -> None:
    def key(values: list[float]) -> bytes:
        row = {"o_shape": [shape]} | {f"o_{part}": [v] for part, v in zip(SCENE[1:], values, strict=True)}
        (found,) = scene_keys(pa.table(row), "o")
        return found

    assert key(numbers) == key([value + 0.0 for value in numbers])
    assert key(numbers) != key([*numbers[:-1], numbers[-1] + 0.5])
