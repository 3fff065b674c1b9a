"""Releases of every schema version are read by this code, and by later code that has more columns."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import rema_data
from rema_data.augment import Augment
from rema_data.convert import import_release
from rema_data.errors import InputError, IntegrityError
from rema_data.release.folder import find_release
from rema_data.release.registry import load_published, published
from rema_data.repair import upgrade
from rema_data.schema import SCHEMA_VERSION
from rema_data.store.block import STEPS, BlockReader
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS, Column
from rema_data.verify import verify

DATA = Path(__file__).resolve().parents[2] / "data"
VERSIONS = range(1, SCHEMA_VERSION + 1)
REPOSITORY = DATA.parents[1]


@pytest.fixture
def manifests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No release is published, and there are no scenario lists to compare with."""
    (tmp_path / "manifests" / "datasets").mkdir(parents=True)
    (tmp_path / "manifests" / "datasets" / "index.json").write_text('{"releases": []}')
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))


def test_the_schema_version_is_that_of_the_newest_column() -> None:
    assert max(column.since for column in (*EPISODE_COLUMNS, *STEP_COLUMNS)) == SCHEMA_VERSION


@pytest.mark.parametrize("columns", [EPISODE_COLUMNS, STEP_COLUMNS], ids=["episodes", "steps"])
def test_a_later_column_is_nullable(columns: tuple[Column, ...]) -> None:
    assert all(column.nullable for column in columns if column.since > 1)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_release_of_every_version_is_read_and_verified(version: int, manifests: None, tmp_path: Path) -> None:
    release = find_release(DATA / "releases" / f"schema-{version}")
    assert release.manifest.schema_version == version
    assert verify(release).ok
    loaded = rema_data.load(release.path, cache=tmp_path)
    assert list(loaded.to_pandas()) == [column.name for column in STEP_COLUMNS]
    dataset = loaded.steps(split="train", which="all")
    batch = Augment(dataset)(dataset[:4].float(), torch.Generator())
    assert len(batch) == 4


@pytest.mark.parametrize("version", VERSIONS)
def test_an_export_of_every_version_gives_the_same_release(version: int, manifests: None, tmp_path: Path) -> None:
    assert import_release([DATA / "exports" / f"schema-{version}.hdf5"], tmp_path / "back").identical


@pytest.mark.parametrize("name", [*published()])
def test_a_published_manifest_keeps_its_bytes(name: str) -> None:
    assert load_published(name).sha256 == published()[name]


LATER = """
import sys
from pathlib import Path

from rema_data import schema
schema.SCHEMA_VERSION += 1
from rema_data.store import columns
new = schema.SCHEMA_VERSION
columns.STEP_COLUMNS += (columns.Column("bounce_m", "float64", "highest bounce", "m", nullable=True, since=new),)
camera = columns.Column("camera", "string", "which camera", nullable=True, since=new, default="top")
columns.EPISODE_COLUMNS += (camera,)

import rema_data
from rema_data.augment import Augment
from rema_data.convert import export_release, import_release
from rema_data.release.folder import find_release
from rema_data.store.block import BlockReader
from rema_data.testing import make_release
from rema_data.verify import verify
import torch

old, folder = Path(sys.argv[1]), Path(sys.argv[2])
release = find_release(old)
assert verify(release).ok

loaded = rema_data.load(old, cache=folder / "cache")
assert loaded.to_pandas()["bounce_m"].isna().all() and (loaded.episodes["camera"] == "top").all()
dataset = loaded.steps(split="train", which="all")
sampler = rema_data.BalancedSampler(dataset, batch_size=2, by=("success",))
loader = torch.utils.data.DataLoader(dataset, batch_sampler=sampler)
batch = Augment(dataset)(next(iter(loader)).float(), torch.Generator())
assert torch.isfinite(batch.scene).all()
first = loaded.episodes.iloc[0]
assert len(loaded.episode(1, first["task"], first["split"], first["episode"]).steps) == first["steps"]

# out and back: the bytes of the earlier version
export_release(release, folder / "export")
assert import_release([folder / "export"], folder / "back").identical

# a release that continues the old one has blocks of both versions
import shutil
root = folder / "root"
shutil.copytree(old, root / old.name)
from rema_data.store.keys import BlockKey
parent = release.manifest
reused = [block.key for block in parent.blocks]
made = make_release(root, "later", tasks=(reused[0].task,), rounds=(2,), episodes=2, parent=parent, reused=reused)
assert made.manifest.schema_version == new
assert verify(made).ok, verify(made)
assert {made.block(block).version() for block in made.manifest.blocks} == {parent.schema_version, new}
both = rema_data.load(made.path, cache=folder / "cache")
assert set(both.to_pandas()) == {column.name for column in columns.STEP_COLUMNS}
assert len(both.steps(which="all")) == made.manifest.counts["steps"]
export_release(made, folder / "export-later")
assert import_release([folder / "export-later"], folder / "back").identical
"""


@pytest.mark.parametrize("version", VERSIONS)
def test_later_code_with_more_columns_reads_and_continues_it(version: int, manifests: None, tmp_path: Path) -> None:
    old = DATA / "releases" / f"schema-{version}"
    done = subprocess.run(
        [sys.executable, "-c", LATER, str(old), str(tmp_path)],
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    later, new = tmp_path / "root" / "later", SCHEMA_VERSION + 1
    with pytest.raises(InputError, match=f"schema version {new}, this rema reads {SCHEMA_VERSION} and") as caught:
        find_release(later)
    assert caught.value.hint == upgrade()
    with pytest.raises(IntegrityError, match=rf"{STEPS} has other columns \(bounce_m\) than schema version") as caught:
        BlockReader(later / "round-2" / "grasp_push" / "train").steps()
    assert caught.value.hint == upgrade()
    with pytest.raises(InputError, match=f"hdf5 has schema version {new}") as caught:
        import_release([tmp_path / "export-later"], tmp_path / "refused")
    assert caught.value.hint == upgrade()
