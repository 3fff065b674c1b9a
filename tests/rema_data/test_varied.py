"""Varied episodes, from their rows to everything that reads a release."""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

import rema_data
from rema_data.convert import export_release, import_release
from rema_data.diff import diff_releases
from rema_data.errors import IntegrityError
from rema_data.gallery import find_steps
from rema_data.publish.card import dataset_card
from rema_data.publish.dataset import publish_release
from rema_data.release.datasheet import has_varied
from rema_data.release.folder import ReleaseFolder
from rema_data.schema import SCHEMA_VERSION, Shape
from rema_data.sheets import describe
from rema_data.statistics.count import count
from rema_data.store import columns
from rema_data.store.block import BlockReader, BlockWriter, encode_episodes
from rema_data.store.columns import VARIATION, Column
from rema_data.store.keys import BlockKey
from rema_data.store.tables import variation_of
from rema_data.testing import make_release, synthetic_episode
from rema_data.variation import variation_from_text, variation_text
from rema_data.verify import verify

reads_croissant = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
KEY = BlockKey(1, "grasp_push", "train")


@pytest.fixture(scope="module")
def varied(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    return make_release(tmp_path_factory.mktemp("varied"), tasks=("grasp", "grasp_push"), episodes=30, varied=True)


@pytest.fixture(scope="module")
def loaded(varied: ReleaseFolder) -> rema_data.Release:
    return rema_data.load(varied.path, cache="memory")


def test_every_invariant_holds(varied: ReleaseFolder) -> None:
    assert varied.manifest.schema_version == 2
    assert verify(varied).ok


def test_a_later_column_changes_nothing_about_which_releases_vary(
    varied: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clean = make_release(tmp_path, tasks=("grasp",), episodes=5)
    counted = count(varied).axes
    later = Column("later_m", "float64", "in the next schema version", nullable=True, since=SCHEMA_VERSION + 1)
    monkeypatch.setattr(columns, "STEP_COLUMNS", (*columns.STEP_COLUMNS, later))
    assert has_varied(varied.manifest) and not has_varied(clean.manifest)
    assert count(varied).axes == counted and len(counted) > 2
    newer = ReleaseFolder(replace(clean.manifest, schema_version=2), clean.root)
    assert count(newer).axes == ()  # its episodes say so, whatever the version


def test_episodes_come_back_as_they_were(loaded: rema_data.Release) -> None:
    """With what was changed in their last step, and the first steps clean."""
    found = list(loaded.iter_episodes(tasks=["grasp_push"], split="train"))
    assert [episode.variation for episode in found] == [
        synthetic_episode(KEY, n, varied=True).variation for n in range(30)
    ]
    assert {variation.axis for one in found if (variation := one.variation)} == {"clutter", "shape", "mixed"}
    for episode in found:
        made = synthetic_episode(KEY, episode.index, varied=True)
        assert [step.situation for step in episode.steps] == [step.situation for step in made.steps]
        for step in episode.steps:
            assert step.situation.variation == (episode.variation if step.situation.last else None)
    assert loaded.episode(1, "grasp_push", "train", 5).variation == found[5].variation


def test_clean_episodes_are_stored_as_before_there_were_varied_ones(tmp_path: Path) -> None:
    """A block without variations has no such column, unless its release has some elsewhere."""
    clean = [synthetic_episode(KEY, n) for n in range(4)]
    for number, version in enumerate((1, 2)):
        writer = BlockWriter(tmp_path / str(number))
        writer.append(*encode_episodes(clean, version))
        writer.close()
        reader = BlockReader(tmp_path / str(number))
        assert reader.version() == version
        assert reader.episodes()[VARIATION].null_count == 4


def test_a_block_has_the_columns_of_all_that_is_appended(tmp_path: Path) -> None:
    """In whatever order clean and varied episodes come."""
    episodes = [synthetic_episode(KEY, n, varied=True) for n in range(4)]
    writer = BlockWriter(tmp_path / "apart")
    for one in episodes:
        writer.append(*encode_episodes([one]))
    writer.close()
    writer = BlockWriter(tmp_path / "together")
    writer.append(*encode_episodes(episodes))
    writer.close()
    for name in ("episodes.parquet", "steps.parquet"):
        assert (tmp_path / "apart" / name).read_bytes() == (tmp_path / "together" / name).read_bytes()


@pytest.mark.parametrize("index", [1, 3, 5])
def test_a_variation_is_one_text(index: int) -> None:
    variation = synthetic_episode(KEY, index, varied=True).variation
    assert variation is not None
    text = variation_text(variation)
    assert variation_from_text(text) == variation
    content = json.loads(text)
    for other in (text + " ", json.dumps(content | {"wind": 1}), json.dumps(content, indent=1), "null", "[]", "{"):
        with pytest.raises(ValueError):
            variation_from_text(other)


def test_a_damaged_variation_is_named() -> None:
    row = {"task": "grasp", "round": 1, "split": "train", "episode": 7, VARIATION: "{}"}
    with pytest.raises(IntegrityError, match="episode grasp/1/train/7 cannot be read") as caught:
        variation_of(row)
    assert "rema verify" in caught.value.hint


def test_conditions_name_what_is_varied(loaded: rema_data.Release) -> None:
    pytest.importorskip("duckdb", reason="conditions need DuckDB, part of the extra `query`")
    clean = loaded.steps(where="variation is null", which="all").table
    assert set(clean["episode"] % 2) == {0}
    shaped = loaded.steps(where="variation->>'axis' = 'shape'", which="all").table
    assert set(shaped["episode"] % 6) == {3}


def test_counts_by_what_is_varied(varied: ReleaseFolder) -> None:
    found = count(varied)
    of_push = {(row.axis, row.level): row for row in found.axes if row.task == "grasp_push"}
    assert set(of_push) == {("", 0), ("clutter", 1), ("shape", 1), ("mixed", 1)}
    (total,) = [row for row in found.totals() if row.task == "grasp_push"]
    for name in ("episodes", "reached", "positives"):
        assert sum(getattr(row, name) for row in of_push.values()) == getattr(total, name)
    assert of_push["clutter", 1].episodes == 6  # 5 for training, and one of six for validation
    assert found.to_dict()["axes"][0]["axis"] == ""
    pytest.importorskip("duckdb", reason="conditions need DuckDB, part of the extra `query`")
    some = count(varied, where="variation->>'axis' = 'shape' and last")
    assert {row.axis for row in some.axes} == {"shape"}


def test_clean_releases_are_counted_as_before(tmp_path: Path) -> None:
    found = count(make_release(tmp_path, tasks=("grasp",), episodes=5))
    assert found.axes == () and "axes" not in found.to_dict()


def test_a_preview_says_what_is_varied(varied: ReleaseFolder) -> None:
    clean, shaped = (find_steps(varied, ["grasp"], split="train", episodes=[n])[0] for n in (2, 3))
    assert clean.row[VARIATION] is None and describe(clean.row)[1].endswith("episode 2, random")
    assert describe(shaped.row)[1].endswith("episode 3, random, shape 1")
    assert shaped.row["target_shape"] == Shape.U


def test_a_difference_in_what_is_varied_is_found(varied: ReleaseFolder, tmp_path: Path) -> None:
    clean = make_release(tmp_path, tasks=("grasp", "grasp_push"), episodes=30)
    found = diff_releases(varied, clean)
    assert "schema_version" in found.fields
    tables = {table.table: table.columns for block in found.blocks for table in block.tables}
    assert tables["episodes"][VARIATION] == 3  # of the last block, for validation
    assert "target_shape" in tables["steps"]


@reads_croissant
def test_the_card_explains_it(varied: ReleaseFolder, caplog: pytest.LogCaptureFixture) -> None:
    sheet = (varied.path / "DATASHEET.md").read_text()
    assert "## Varied episodes" in sheet and "| `variation` | string |" in sheet
    records = _records(varied.path / "croissant.json", caplog)
    assert len(records) == varied.manifest.counts["episodes"]
    told = [record["episodes/variation"] for record in records]
    assert sum(isinstance(text, bytes) for text in told) == 36


@reads_croissant
def test_a_release_with_earlier_blocks_is_published(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The description of all tables has the columns that all of them have."""
    parent = make_release(tmp_path / "root", "older", tasks=("grasp",), episodes=5)
    keys = [block.key for block in parent.manifest.blocks]
    made = make_release(
        *(tmp_path / "root", "newer", ("push",), (2,), 6), parent=parent.manifest, reused=keys, varied=True
    )
    assert [made.block(block).version() for block in made.manifest.blocks] == [1, 1, 2, 2]
    publish_release(made, tmp_path / "hub")
    records = _records(tmp_path / "hub" / "croissant.json", caplog)
    assert len(records) == made.manifest.counts["episodes"] and "episodes/variation" not in records[0]
    front = yaml.safe_load(dataset_card(made.manifest, "org/name", viewer=False).split("---\n")[1])
    paths = {config["config_name"]: config["data_files"][0]["path"] for config in front["configs"]}
    assert paths == {
        "steps": "*/round-*/*/train/steps.parquet",
        "episodes": "newer/round-*/*/train/episodes.parquet",
        "episodes-earlier": "older/round-*/*/train/episodes.parquet",
    }


@reads_croissant
def test_a_copy_of_blocks_of_both_versions_describes_what_all_of_them_have(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """An import under another name holds them all itself."""
    parent = make_release(tmp_path / "root", "older", tasks=("grasp",), episodes=5)
    keys = [block.key for block in parent.manifest.blocks]
    made = make_release(
        *(tmp_path / "root", "newer", ("push",), (2,), 6), parent=parent.manifest, reused=keys, varied=True
    )
    export_release(made, tmp_path / "export")
    copy = import_release([tmp_path / "export"], tmp_path / "back", "copy").release
    assert copy.manifest.schema_version == 2
    assert [copy.block(block).version() for block in copy.manifest.blocks] == [1, 1, 2, 2]
    records = _records(copy.path / "croissant.json", caplog)
    assert len(records) == copy.manifest.counts["episodes"] and "episodes/variation" not in records[0]


def _records(path: Path, caplog: pytest.LogCaptureFixture) -> list[Any]:
    import mlcroissant

    with caplog.at_level(logging.WARNING):
        dataset = mlcroissant.Dataset(str(path))
    assert dataset.metadata.ctx.issues.errors == set()
    return list(dataset.records("episodes"))
