"""The card of a release: counts that agree with the manifest, and a Croissant file that its own reader accepts."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import logging
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from rema_data.release.card import CARD, write_card
from rema_data.release.datasheet import column_table, datasheet
from rema_data.release.folder import ReleaseFolder
from rema_data.store.block import BlockKey, BlockReader
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS, columns_at
from rema_data.testing import make_release

reads_croissant = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")


def read(path: Path, caplog: pytest.LogCaptureFixture) -> Any:
    """The dataset that mlcroissant makes of a description, and no complaint."""
    import mlcroissant

    with caplog.at_level(logging.WARNING):
        dataset = mlcroissant.Dataset(str(path))
    assert dataset.metadata.ctx.issues.errors == set()
    return dataset


def test_the_card_is_sealed_with_the_release(tiny: ReleaseFolder) -> None:
    listed = {file.path for file in tiny.manifest.files if file.block is None}
    assert listed == set(CARD)


def test_the_bytes_of_the_card_follow_from_the_manifest(tiny: ReleaseFolder, tmp_path: Path) -> None:
    draft = dataclasses.replace(
        tiny.manifest, files=tuple(file for file in tiny.manifest.files if file.block is not None)
    )
    write_card(tmp_path, draft)
    for name in CARD:
        assert (tmp_path / name).read_bytes() == (tiny.path / name).read_bytes()


@reads_croissant
def test_croissant_reads_every_record(tiny: ReleaseFolder, caplog: pytest.LogCaptureFixture) -> None:
    dataset = read(tiny.path / "croissant.json", caplog)
    assert [issue for issue in dataset.metadata.ctx.issues.warnings if "datePublished" not in issue] == []
    for name, columns in (("episodes", EPISODE_COLUMNS), ("steps", STEP_COLUMNS)):
        records = list(dataset.records(name))
        assert len(records) == tiny.manifest.counts[name]
        assert list(records[0]) == [f"{name}/{column.name}" for column in columns_at(columns, 1)]
    (first,) = [
        record
        for record in records
        if (record["steps/task"], record["steps/split"]) == (b"grasp_push", b"val")
        and (record["steps/episode"], record["steps/step"]) == (0, 1)
    ]
    key = BlockKey(1, "grasp_push", "val")
    row = BlockReader(tiny.path / key.path).steps().to_pylist()[1]
    for name, value in row.items():
        expected = value.encode() if isinstance(value, str) else value
        assert first[f"steps/{name}"] == expected


@reads_croissant
def test_a_release_with_a_day_leaves_croissant_nothing_to_say(
    tiny: ReleaseFolder, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_card(tmp_path, dataclasses.replace(tiny.manifest, published="2026-01-31"))
    dataset = read(tmp_path / "croissant.json", caplog)
    assert dataset.metadata.ctx.issues.warnings == set()
    assert caplog.records == []
    assert dataset.metadata.date_published.isoformat().startswith("2026-01-31")


def test_croissant_names_the_bytes_of_every_table(tiny: ReleaseFolder) -> None:
    described = json.loads((tiny.path / "croissant.json").read_bytes())
    objects = [entry for entry in described["distribution"] if entry["@type"] == "cr:FileObject"]
    assert len(objects) == 2 * len(tiny.manifest.blocks)
    for entry in objects:
        data = (tiny.path / entry["contentUrl"]).read_bytes()
        assert entry["contentSize"] == f"{len(data)} B"
        assert entry["sha256"] == hashlib.sha256(data).hexdigest()


def test_every_file_of_a_block_is_described_by_croissant(tiny: ReleaseFolder) -> None:
    described = json.loads((tiny.path / "croissant.json").read_bytes())
    patterns = [
        pattern.replace("**", "*") for entry in described["distribution"] for pattern in entry.get("includes", [])
    ]
    expressions = [re.compile(pattern.replace(".", r"\.").replace("*", ".*")) for pattern in patterns]
    for file in tiny.manifest.files:
        if file.block is not None:
            assert any(expression.fullmatch(file.path) for expression in expressions), file.path


def test_tables_of_the_parent_are_found_beside_the_release(tiny: ReleaseFolder) -> None:
    key = BlockKey(1, "grasp", "train")
    child = make_release(tiny.root, "child", tasks=("push",), episodes=5, parent=tiny.manifest, reused=(key,))
    described = json.loads((child.path / "croissant.json").read_bytes())
    shared = [entry for entry in described["distribution"] if entry.get("contentUrl", "").startswith("../")]
    assert [entry["@id"] for entry in shared] == [f"{key.path}/episodes.parquet", f"{key.path}/steps.parquet"]
    for entry in shared:
        assert entry["sha256"] == hashlib.sha256((child.path / entry["contentUrl"]).read_bytes()).hexdigest()
    assert "1 (in tiny)" in (child.path / "DATASHEET.md").read_text()


def row_of(text: str, *cells: str) -> list[str]:
    """Cells of the one table row that begins with ``cells``."""
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line[:1] == "|"]
    (row,) = [row for row in rows if tuple(row[: len(cells)]) == cells]
    return row


def test_counts_of_the_datasheet_are_those_of_the_tables(tiny: ReleaseFolder) -> None:
    text = (tiny.path / "DATASHEET.md").read_text()
    for block in tiny.manifest.blocks:
        reader = tiny.block(block)
        won = reader.episodes()["success"].to_pylist()
        row = row_of(text, "1", block.task, block.split)
        share = f"{100 * sum(won) / len(won):.1f}"
        assert row[4:8] == [f"{len(won)}", f"{sum(won)}", share, f"{reader.steps().num_rows}"]
    total = row_of(text, "all", "", "")
    assert total[4] == str(tiny.manifest.counts["episodes"])
    assert total[7] == str(tiny.manifest.counts["steps"])


def test_the_datasheet_explains_every_column(tiny: ReleaseFolder) -> None:
    text = (tiny.path / "DATASHEET.md").read_text()
    for columns in (EPISODE_COLUMNS, STEP_COLUMNS):
        assert column_table(columns_at(columns, 1)) in text
    for column in STEP_COLUMNS:
        row = row_of(column_table(STEP_COLUMNS), f"`{column.name}`")
        assert row[1:] == [column.type, column.unit, column.frame, "yes" if column.nullable else "", column.meaning]


def test_the_citation_is_whole_yaml(tiny: ReleaseFolder) -> None:
    cited = yaml.safe_load((tiny.path / "CITATION.cff").read_text())
    assert cited["cff-version"] == "1.2.0"
    assert cited["type"] == "dataset"
    assert cited["license"] == "CC-BY-4.0"
    assert tiny.manifest.citation in cited["message"]
    assert cited["authors"][0]["name"]
    assert cited["references"][0]["url"] == "https://arxiv.org/abs/2112.00359"


@pytest.mark.parametrize("text", ['"quoted": yes #', "two\nlines", "Größe: 3 µm"])
def test_texts_with_special_characters_stay_what_they_are(text: str, tiny: ReleaseFolder, tmp_path: Path) -> None:
    write_card(tmp_path, dataclasses.replace(tiny.manifest, title=text, citation=text))
    cited = yaml.safe_load((tmp_path / "CITATION.cff").read_text())
    assert cited["title"] == text
    assert json.loads((tmp_path / "croissant.json").read_bytes())["citeAs"] == text


def test_the_licence_names_its_text(tiny: ReleaseFolder, tmp_path: Path) -> None:
    notice = (tiny.path / "LICENSE").read_text()
    assert "SPDX-License-Identifier: CC-BY-4.0" in notice
    assert "https://creativecommons.org/licenses/by/4.0/" in notice
    write_card(tmp_path, dataclasses.replace(tiny.manifest, license="ODbL-1.0"))
    assert "https://spdx.org/licenses/ODbL-1.0.html" in (tmp_path / "LICENSE").read_text()


def test_a_release_without_blocks_has_a_card(tiny: ReleaseFolder) -> None:
    empty = dataclasses.replace(tiny.manifest, blocks=(), files=())
    assert row_of(datasheet(empty), "all", "", "")[4:7] == ["0", "0", "-"]


@pytest.mark.parametrize(("name", "version"), [("rema-mini", "1.0.0"), ("rema-v2", "2.0.0"), ("rema-v12", "12.0.0")])
def test_the_version_is_that_of_the_name(name: str, version: str, tiny: ReleaseFolder, tmp_path: Path) -> None:
    write_card(tmp_path, dataclasses.replace(tiny.manifest, name=name))
    assert json.loads((tmp_path / "croissant.json").read_bytes())["version"] == version
