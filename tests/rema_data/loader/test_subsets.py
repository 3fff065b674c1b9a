"""Fixed subsets: nested fractions, replicates that share nothing, and rows that are checked."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import rema_data
from rema_data.errors import InputError, IntegrityError
from rema_data.loader.subsets import freeze_subsets
from rema_data.manifests import manifests_dir
from rema_data.release.registry import load_published, published
from rema_data.release.subsets import FRACTIONS, REPLICATES, in_subset, large_enough, names, subsets_of
from rema_data.testing import make_release


@pytest.fixture(scope="module")
def sample() -> rema_data.Release:
    return rema_data.load("rema-sample")


def episodes(release: rema_data.Release, **selection: object) -> set[tuple[str, int, str, int]]:
    table = release.steps(which="all", **selection).table  # type: ignore[arg-type]
    return set(zip(table["task"], table["round"], table["split"], table["episode"], strict=True))


def test_fractions_nest_and_replicates_share_nothing() -> None:
    block = load_published("rema-mini").blocks[0]
    assert block.episodes == 2000
    for fraction, percent in FRACTIONS.items():
        masks = np.array([in_subset(f"{fraction}-r{number}", block) for number in range(1, REPLICATES + 1)])
        assert masks.sum(1).tolist() == [block.episodes * percent // 100] * REPLICATES
        assert masks.sum(0).max() == 1
    assert masks.any(0).all()  # ten tenths are everything
    for number in range(1, REPLICATES + 1):
        small, large = in_subset(f"1pct-r{number}", block), in_subset(f"10pct-r{number}", block)
        assert not (small & ~large).any()


def test_a_subset_is_a_part_of_the_training_episodes_of_every_block(sample: rema_data.Release) -> None:
    tenth = episodes(sample, split="train", subset="10pct-r3")
    assert len(tenth) == 10 * len({(task, number) for task, number, _, _ in tenth}) == 100
    assert episodes(sample, split="train", subset="1pct-r3") < tenth < episodes(sample, split="train")
    assert episodes(sample, split="val", subset="1pct-r3") == episodes(sample, split="val")


def test_a_subset_has_an_identity_of_its_own(sample: rema_data.Release) -> None:
    found = {sample.steps(subset=name).fingerprint for name in (None, "1pct-r1", "10pct-r1")}
    assert len(found) == 3


def test_what_is_published_has_the_subsets_that_its_manifest_says() -> None:
    for name in published():
        manifest = load_published(name)
        if large_enough(manifest):
            assert set(subsets_of(manifest).subsets) == set(names())


def test_freezing_again_changes_nothing(sample: rema_data.Release, tmp_path: Path) -> None:
    before = subsets_of(sample.manifest)
    path = freeze_subsets(sample)
    assert subsets_of(sample.manifest) == before
    assert path.stat().st_size < 1 << 16


@pytest.mark.parametrize("name", ["10pct", "10pct-r0", "10pct-r11", "5pct-r1", "10pct-r01", ""])
def test_an_unknown_subset_is_refused_by_name(sample: rema_data.Release, name: str) -> None:
    with pytest.raises(InputError, match="there is no subset") as caught:
        sample.steps(split="train", subset=name)
    assert "10pct-r1" in str(caught.value.hint)


def test_a_release_without_subsets(tmp_path: Path) -> None:
    make_release(tmp_path, name="own", tasks=("grasp",), episodes=10)
    with pytest.raises(InputError, match="release own has no fixed subsets") as caught:
        rema_data.load(tmp_path / "own", cache="memory").steps(subset="10pct-r1")
    assert "rema-sample" in str(caught.value.hint)


def test_the_subset_of_another_release_is_refused(tmp_path: Path) -> None:
    make_release(tmp_path, name="rema-sample", tasks=("grasp",), episodes=10)
    with pytest.raises(InputError, match="other content"):
        rema_data.load(tmp_path / "rema-sample", cache="memory").steps(subset="10pct-r1")


def damaged(content: dict[str, object], kind: str) -> str:
    if kind == "truncated":
        return json.dumps(content)[:-10]
    rows = content["subsets"]["10pct-r1"]["round-1/grasp/train"]  # type: ignore[index]
    rows["sha256"] = 3 if kind == "a number for text" else "0" * 64
    plain = {name: value for name, value in content.items() if name != "content_sha256"}
    return json.dumps(content if kind == "a flipped digit" else plain)


@pytest.mark.parametrize("kind", ["other rows", "a flipped digit", "a number for text", "truncated"])
def test_a_damaged_manifest_is_an_error(
    sample: rema_data.Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    whole = manifests_dir()
    content = json.loads((whole / "subsets" / "rema-sample.json").read_text())
    (tmp_path / "datasets").symlink_to(whole / "datasets")
    (tmp_path / "subsets").mkdir()
    (tmp_path / "subsets" / "rema-sample.json").write_text(damaged(content, kind))
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path))
    with pytest.raises(IntegrityError):
        sample.steps(tasks=["grasp"], subset="10pct-r1")
