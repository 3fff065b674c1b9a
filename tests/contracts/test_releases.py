"""What is published is immutable: every release and every network of this repository has the bytes that were sealed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from evaluator.policy.named import is_adapted
from evaluator.policy.shipped import shipped_policies
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST, parse_manifest
from rema_data.release.registry import published
from rema_data.storage import file_sha256
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS

ROOT = Path(__file__).parents[2]
RELEASES = ROOT / "releases"
pytestmark = pytest.mark.skipif(not (RELEASES / "checkpoints").is_dir(), reason="the releases come with a clone only")


def release_folders() -> dict[str, ReleaseFolder]:
    found = {}
    for path in sorted(RELEASES.glob(f"*/{MANIFEST}")):
        manifest = parse_manifest(path.read_bytes(), str(path))
        found[manifest.name] = ReleaseFolder(manifest, RELEASES)
    return found


def test_the_published_ones_are_here() -> None:
    here = release_folders()
    assert published() == {name: here[name].manifest.sha256 for name in published()}


@pytest.mark.parametrize("name", sorted(path.parent.name for path in RELEASES.glob(f"*/{MANIFEST}")))
def test_every_file_has_the_sealed_bytes(name: str) -> None:
    release = release_folders()[name]
    assert release.path.name == name and release.manifest.files
    for entry in release.manifest.files:
        path = release.file(entry)
        assert (path.stat().st_size, file_sha256(path)) == (entry.bytes, entry.sha256), entry.location


def test_every_network_names_the_release_that_it_learned_from() -> None:
    releases, cards = release_folders(), sorted((RELEASES / "checkpoints").glob("*/*/*.json"))
    assert cards
    for path in cards:
        card = json.loads(path.read_text())
        assert file_sha256(path.with_suffix(".safetensors")) == card["sha256"], path
        assert releases[card["release"]].manifest.sha256 == card["release_sha256"], path


def test_the_shipped_networks_are_clean_trained() -> None:
    """A release has no place for a changed situation; what learns from one that has it is adapted."""
    assert not {"variation", "axis", "level"} & {column.name for column in (*EPISODE_COLUMNS, *STEP_COLUMNS)}
    assert shipped_policies() and not any(map(is_adapted, shipped_policies()))
