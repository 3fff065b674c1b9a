"""What is published is immutable: every release and every network of this repository has the bytes that were sealed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from evaluator.policy.named import is_adapted
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST, parse_manifest
from rema_data.release.registry import published
from rema_data.storage import file_sha256

ROOT = Path(__file__).parents[2]
RELEASES = ROOT / "releases"
SHIPPED = json.loads((ROOT / "manifests" / "checkpoints.json").read_text())["policies"]
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


@pytest.mark.parametrize("policy", sorted(SHIPPED))
def test_a_policy_is_adapted_where_a_release_of_its_cards_has_changed_situations(policy: str) -> None:
    releases, entries = release_folders(), [SHIPPED[policy], *SHIPPED[policy].get("tasks", {}).values()]
    cards = [path for entry in entries for path in (RELEASES / "checkpoints" / entry["folder"]).glob("*.json")]
    names = {json.loads(path.read_text())["release"] for path in cards}
    tables = [releases[name].block(entry).episodes() for name in names for entry in releases[name].manifest.blocks]
    assert tables and is_adapted(policy) == any(
        "variation" in table.column_names and table["variation"].null_count < len(table) for table in tables
    )
