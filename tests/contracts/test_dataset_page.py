"""docs/dataset.md: what it says of the format is what the code writes, and its reader reads it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rema_data.heights import HEIGHT_OFFSET_M, HEIGHT_OFFSET_STEPS, MISSING, dequantise, unpack_mask
from rema_data.loader.decode import row_bytes
from rema_data.release.datasheet import column_table
from rema_data.release.manifest import BlockEntry, FileEntry, Manifest
from rema_data.release.registry import load_published, published
from rema_data.schema import HEIGHT_STEP_M, TASKS, Failure
from rema_data.store.block import BlockKey, BlockReader
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS, Column
from rema_data.store.maps import ARRAYS
from rema_data.testing import make_block

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "dataset.md").read_text(encoding="utf-8")
KEY = BlockKey(1, "grasp_push", "train")


def rows(text: str) -> list[list[str]]:
    """Cells of all table rows."""
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line[:1] == "|"]


def section(title: str) -> str:
    return PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]


@pytest.mark.parametrize("columns", [EPISODE_COLUMNS, STEP_COLUMNS], ids=["episodes", "steps"])
def test_every_column_is_described_as_in_the_code(columns: tuple[Column, ...]) -> None:
    wanted = column_table(columns)
    assert wanted in PAGE, f"put this table into docs/dataset.md:\n{wanted}"


def test_the_releases_have_the_sizes_of_their_manifests() -> None:
    found = {line[0].split("`")[1]: line for line in rows(section("Releases and blocks")) if "rema-" in line[0]}
    assert found.keys() == published().keys()
    for name, line in found.items():
        counts = load_published(name).counts
        maps = {"scene": counts["steps"]} | dict.fromkeys(("ee_depth", "ee_mask"), counts["end_effectors"])
        decoded = sum(count * row_bytes(array) for array, count in maps.items())
        stored = f"{counts['bytes'] / 1e6:.{0 if counts['bytes'] > 1e7 else 1}f} MB"
        assert (*line[1:3], *line[4:]) == (
            f"{counts['episodes']:,}",
            f"{counts['steps']:,}",
            stored,
            f"{decoded / 1e9:.1f} GB",
        )


def test_the_arrays_are_those_of_the_code() -> None:
    described = {cells[0]: cells[1:] for cells in rows(section("The maps"))}
    for name, form in ARRAYS.items():
        count = "S" if name == "scene" else "M"
        shape = f"({', '.join(map(str, (count, *form.row)))})"
        wanted = [form.dtype, shape, f"{form.chunk_rows} rows", f"{form.shard_rows} rows", str(form.fill)]
        assert described[f"`{name}`"] == wanted


def test_every_field_of_the_manifest_is_described() -> None:
    described = set(re.findall(r"`(\w+)`", " ".join(cells[0] for cells in rows(section("The manifest")))))
    fields = {name for kind in (Manifest, BlockEntry, FileEntry) for name in kind.__dataclass_fields__}
    assert fields | {"format", "heights", "counts"} == described


def test_tasks_and_labels_are_those_of_the_code() -> None:
    described = {cells[0].strip("`"): cells[1] for cells in rows(section("The tables"))}
    for task, steps in TASKS.items():
        assert described[task] == ", ".join(f"{kind.primitive.value} ({kind.embodiment.value})" for kind in steps)
    assert {label.value for label in Failure} <= set(described)


def test_the_formula_of_heights_is_that_of_the_code() -> None:
    text = section("The maps")
    assert f"`v * {HEIGHT_STEP_M:g} - {-HEIGHT_OFFSET_M:g}` metres" in text
    assert f"`float32(v - {HEIGHT_OFFSET_STEPS}) * float32({HEIGHT_STEP_M:g})`" in text
    assert f"A single value of {MISSING}" in text


def test_the_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Selections, conditions, episodes and statistics, as they are written."""
    pytest.importorskip("duckdb", reason="conditions need DuckDB, part of the extra `query`")
    monkeypatch.setenv("REMA_HOME", str(tmp_path))
    using = section("Using it").split("### Several processes")[0]
    names: dict[str, Any] = {}
    for code in re.findall(r"```python\n(.*?)```", using, flags=re.DOTALL):
        exec(compile(code, "docs/dataset.md", "exec"), names)
    assert names["episode"].success and names["height_m"] > 0 and names["std_m"] > 0
    assert set(names["early"].table["step"]) == {0} and len(names["short"]) > 0


@pytest.fixture(scope="module")
def reader() -> dict[str, Any]:
    """The functions of the page's reader."""
    code = section("A reader without this package").split("```python\n")[1].split("```")[0]
    assert not re.search(r"import (rema|zarr)", code)
    names: dict[str, Any] = {}
    exec(compile(code, "docs/dataset.md", "exec"), names)
    return names


@pytest.fixture(scope="module")
def block(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("block")
    make_block(folder, KEY, 8)
    return folder


def test_the_reader_reads_every_map(reader: dict[str, Any], block: Path) -> None:
    maps = BlockReader(block).maps()
    for name in ARRAYS:
        assert np.array_equal(reader["read_array"](block / "maps.zarr" / name), maps.read(name, 0, maps.rows(name)))


def test_the_reader_reads_a_step(reader: dict[str, Any], block: Path) -> None:
    steps = BlockReader(block).steps().to_pylist()
    maps = BlockReader(block).maps()
    row = len(steps) - 1
    step, scene, depth, mask = reader["read_step"](block, row)
    assert step == steps[row]
    assert scene.tobytes() == dequantise(maps.read("scene", step["scene_row"], step["scene_row"] + 1)).tobytes()
    assert depth.tobytes() == dequantise(maps.read("ee_depth", step["ee_row"], step["ee_row"] + 1)).tobytes()
    assert np.array_equal(mask, unpack_mask(maps.read("ee_mask", step["ee_row"], step["ee_row"] + 1))[0])


def test_the_reader_refuses_a_changed_byte(reader: dict[str, Any], block: Path) -> None:
    path = block / "maps.zarr" / "scene" / "c" / "0" / "0" / "0"
    data = path.read_bytes()
    try:
        for place, why in ((20, "a chunk is damaged"), (-20, "the index is damaged")):
            changed = bytearray(data)
            changed[place] ^= 4
            path.write_bytes(bytes(changed))
            with pytest.raises(AssertionError, match=why):
                reader["read_array"](block / "maps.zarr" / "scene")
    finally:
        path.write_bytes(data)
