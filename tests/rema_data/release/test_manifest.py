"""The manifest: whatever the bytes are, the answer is a manifest, an IntegrityError or an InputError."""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path, PureWindowsPath
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rema_data.errors import InputError, IntegrityError
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import (
    ENCODING,
    FORMAT,
    BlockEntry,
    FileEntry,
    Manifest,
    Parent,
    check_name,
    parse_manifest,
)
from rema_data.schema import SCHEMA_VERSION, TASK_NUMBERS, TASKS
from rema_data.store.block import SPLITS, BlockKey

law = settings(max_examples=60, deadline=None)

TEXT = st.text(st.characters(codec="utf-8"), max_size=20)
NAMES = st.from_regex(r"[a-z0-9][a-z0-9_-]{0,10}", fullmatch=True)
COUNTS = st.integers(0, 2**40)
SHAS = st.binary(min_size=32, max_size=32).map(bytes.hex)
KEYS = st.builds(BlockKey, st.integers(1, 9), st.sampled_from(list(TASKS)), st.sampled_from(SPLITS))


@st.composite
def manifests(draw: st.DrawFn) -> Manifest:
    """Manifests that say what they like, and contradict nothing."""
    name, older = draw(NAMES), draw(NAMES)
    keys = draw(st.lists(KEYS, min_size=1, max_size=4, unique=True))
    keys.sort(key=lambda key: (key.round, TASK_NUMBERS[key.task], key.split))
    blocks, files = [], [FileEntry("LICENSE", draw(COUNTS), draw(SHAS), name)]
    for key in keys:
        holder = draw(st.sampled_from([name, older]))
        policies = tuple(draw(TEXT) for _ in TASKS[key.task])
        counts = draw(st.tuples(COUNTS, COUNTS, COUNTS, COUNTS))
        blocks.append(BlockEntry(*key, *counts, policies=policies, holder=holder))
        files.append(FileEntry(f"{key.path}/steps.parquet", draw(COUNTS), draw(SHAS), holder))
    texts = draw(st.tuples(TEXT, TEXT, TEXT, TEXT))
    return Manifest(
        name,
        *texts,
        tuple(blocks),
        tuple(sorted(files, key=lambda file: file.location)),
        fingerprint=draw(st.dictionaries(TEXT, TEXT, max_size=3)),
        plan_sha256=draw(TEXT),
        parent=draw(st.none() | st.builds(Parent, NAMES, SHAS)),
        sources=tuple(draw(st.lists(TEXT, max_size=2))),
        published=draw(st.sampled_from(["", "2026-01-31"])),
    )


@law
@given(manifests())
def test_round_trip(manifest: Manifest) -> None:
    data = manifest.to_bytes()
    for sha256 in (None, manifest.sha256):  # every field checked, or trusted by its hash
        read = parse_manifest(data, "here", sha256)
        assert read == manifest
        assert read.sha256 == hashlib.sha256(data).hexdigest()


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


def refused(data: bytes) -> None:
    with pytest.raises((IntegrityError, InputError)) as caught:
        parse_manifest(data, "here")
    assert caught.value.hint


@law
@given(st.binary() | JSON.map(lambda value: json.dumps(value).encode()))
def test_other_bytes_are_refused(data: bytes) -> None:
    refused(data)


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every place inside a JSON value."""
    inner: list[tuple[Any, Any]] = []
    if isinstance(value, dict):
        inner = list(value.items())
    elif isinstance(value, list):
        inner = list(enumerate(value))
    return [path, *(place for key, item in inner for place in places(item, (*path, key)))]


CONTENT = json.loads(
    Manifest(
        "tiny",
        "title",
        "description",
        "CC-BY-4.0",
        "citation",
        (
            BlockEntry(1, "grasp", "train", 3, 3, 1, 1, ("random",), "tiny"),
            BlockEntry(1, "grasp", "val", 1, 1, 1, 0, ("random",), "older"),
        ),
        (
            FileEntry("round-1/grasp/val/steps.parquet", 7, "0" * 64, "older"),
            FileEntry("LICENSE", 5, "1" * 64, "tiny"),
            FileEntry("round-1/grasp/train/steps.parquet", 7, "2" * 64, "tiny"),
        ),
        fingerprint={"pybullet": "3.2.7"},
        parent=Parent("older", "3" * 64),
        sources=("https://example.org/releases",),
    ).to_bytes()
)
PLACES = places(CONTENT)


def canonical(content: Any) -> bytes:
    return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode("utf-8", "surrogatepass")


def test_the_example_is_read() -> None:
    assert parse_manifest(canonical(CONTENT), "here").name == "tiny"


def at(content: Any, place: tuple[Any, ...]) -> Any:
    for key in place:
        content = content[key]
    return content


@law
@given(st.sampled_from(PLACES), JSON)
def test_an_edit_is_refused_or_read_as_it_is(place: tuple[Any, ...], value: Any) -> None:
    content = copy.deepcopy({"all": CONTENT})
    at(content, ("all", *place)[:-1])[("all", *place)[-1]] = value
    data = canonical(content["all"])
    try:
        manifest = parse_manifest(data, "here")
    except (IntegrityError, InputError):
        return
    assert manifest.to_bytes() == data


@law
@given(st.sampled_from([place for place in PLACES if place]))
def test_what_is_left_out_is_refused_or_read_as_it_is(place: tuple[Any, ...]) -> None:
    content = copy.deepcopy(CONTENT)
    del at(content, place[:-1])[place[-1]]
    if place in {("fingerprint", "pybullet"), ("sources", 0)}:
        assert parse_manifest(canonical(content), "here").to_bytes() == canonical(content)
    else:
        refused(canonical(content))


@law
@given(st.text(max_size=30) | st.from_regex(r"[a./\\:~]{0,12}", fullmatch=True))
def test_no_path_leads_out_of_the_release(path: str) -> None:
    content = copy.deepcopy(CONTENT)
    content["files"][1]["path"] = path
    try:
        manifest = parse_manifest(canonical(content), "here")
    except (IntegrityError, InputError):
        return
    folder = Path("/releases")
    places = [Path(os.path.normpath(folder / file.location)) for file in manifest.files]
    assert all(folder / file.holder in place.parents for file, place in zip(manifest.files, places, strict=True))
    assert not any(PureWindowsPath(file.path).drive or "\\" in file.path for file in manifest.files)


@pytest.mark.parametrize(
    "path",
    [
        "../other/file",
        "a/../../file",
        "/etc/passwd",
        "//server/share",
        "..",
        "",
        "a//b",
        "./a",
        "a/.",
        "a\\..\\b",
        "C:/file",
        "c:file",
        "a\0b",
        "a\nb",
        "x" * 600,
    ],
)
def test_a_path_that_climbs_is_refused(path: str) -> None:
    content = copy.deepcopy(CONTENT)
    content["files"][1]["path"] = path
    with pytest.raises(IntegrityError, match="does not stay inside the release"):
        parse_manifest(canonical(content), "here")


@pytest.mark.parametrize("holder", ["..", "../x", "/", "", "a/b", "a..b", "A", "a\\b", ".hidden"])
def test_a_holder_that_climbs_is_refused(holder: str) -> None:
    content = copy.deepcopy(CONTENT)
    content["files"][0]["holder"] = content["blocks"][1]["holder"] = holder
    with pytest.raises(IntegrityError, match="cannot name a release"):
        parse_manifest(canonical(content), "here")
    with pytest.raises(InputError, match="cannot name a release"):
        check_name(holder)


def twice(name: str) -> Callable[[Any], None]:
    return lambda content: content[name].append(copy.deepcopy(content[name][0]))


def changed(*place: Any, to: Any) -> Callable[[Any], None]:
    def change(content: Any) -> None:
        for key in place[:-1]:
            content = content[key]
        content[place[-1]] = to

    return change


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (twice("files"), "is listed twice"),
        (twice("blocks"), "a block is listed twice"),
        (changed("files", 2, "holder", to="older"), "does not lie where its block does"),
        (changed("files", 1, "holder", to="older"), "does not lie where its block does"),
        (changed("files", 1, "path", to="round-7/grasp/train/steps.parquet"), "does not lie where its block does"),
        (lambda content: content["files"].pop(0), "a block has no files"),
        (changed("files", 0, "sha256", to="A" * 64), "has the sha256"),
        (changed("files", 0, "bytes", to=-1), "bytes is -1"),
        (changed("files", 0, "bytes", to=True), "bytes is True"),
        (changed("files", 0, "extra", to=1), r"files\[0\].extra is not a known field"),
        (changed("blocks", 0, "task", to="juggle"), "is not the name of a block"),
        (changed("blocks", 0, "split", to="test"), "is not the name of a block"),
        (changed("blocks", 0, "round", to=0), "is not the name of a block"),
        (changed("blocks", 0, "policies", to=["random"] * 2), "does not name a policy for each step"),
        (changed("heights", "step_m", to=0.001), "heights are stored in an unknown way"),
        (changed("heights", to={**ENCODING, "more": 1}), "heights are stored in an unknown way"),
        (changed("counts", "episodes", to=5), "its counts do not add up"),
        (changed("more", to=1), "it is not in canonical form"),
        (changed("published", to="soon"), "not a day such as"),
        (changed("published", to=""), "it is not in canonical form"),
        (changed("published", to="2026-99-99"), "not a day such as"),
        (changed("published", to="2026-02-30"), "not a day such as"),
        (changed("published", to="٢٠٢٦-01-31"), "not a day such as"),
        (lambda content: content["files"].reverse(), "the files are not in their order"),
        (lambda content: content["blocks"].reverse(), "the blocks are not in their order"),
        (changed("parent", "name", to="../../x"), "cannot name a release"),
        (changed("parent", "sha256", to="zz"), "the parent older has the sha256 'zz'"),
        (lambda content: content.pop("schema_version"), "schema_version is missing"),
        (lambda content: content.pop("blocks"), "blocks is missing"),
        (changed("format", to="another release"), "it does not say that it is a rema release"),
        (changed("title", to="\ud800"), "surrogates not allowed"),
    ],
)
def test_a_contradiction_is_named(change: Callable[[Any], None], reason: str) -> None:
    content = copy.deepcopy(CONTENT)
    change(content)
    data = (json.dumps(content, indent=1) + "\n").encode()
    if "surrogates" not in reason:
        data = canonical(content)
    with pytest.raises(IntegrityError, match=reason) as caught:
        parse_manifest(data, "some/manifest.json")
    assert "some/manifest.json" in caught.value.message
    assert caught.value.hint == "copy some/manifest.json again from where it came from"


def test_every_wrong_field_is_named() -> None:
    content = copy.deepcopy(CONTENT)
    content["files"][1]["bytes"], content["blocks"][0]["task"], content["title"] = "5", None, 7
    with pytest.raises(IntegrityError) as caught:
        parse_manifest(canonical(content), "here")
    for part in ("title is 7", "blocks[0].task is None", "files[1].bytes is '5'"):
        assert part in caught.value.message


def test_other_spelling_of_the_same_content_is_refused() -> None:
    for data in (json.dumps(CONTENT).encode(), canonical(CONTENT)[:-1], b"\xef\xbb\xbf" + canonical(CONTENT)):
        with pytest.raises(IntegrityError):
            parse_manifest(data, "here")


@pytest.mark.parametrize("version", [SCHEMA_VERSION + 1, 0, -1, "1", None, 1.5, [1]])
def test_an_unknown_schema_version_names_both(version: Any) -> None:
    content = copy.deepcopy(CONTENT)
    content["schema_version"] = version
    with pytest.raises(InputError, match=f"this rema reads {SCHEMA_VERSION}") as caught:
        parse_manifest(canonical(content), "here")
    assert "pip install --upgrade" in caught.value.hint
    assert caught.value.facts["schema_version"] == version


def test_a_changed_byte_is_not_the_published_manifest() -> None:
    data = canonical(CONTENT)
    sha256 = hashlib.sha256(data).hexdigest()
    with pytest.raises(IntegrityError, match="expected") as caught:
        parse_manifest(data.replace(b"title", b"tithe"), "here", sha256)
    assert caught.value.facts["expected"] == sha256


def test_deep_nesting_is_refused() -> None:
    refused(b"[" * 100_000)
    refused(b'{"format": "' + FORMAT.encode() + b'", "schema_version": 1, "blocks": ' + b"[" * 100_000)


def test_select(tiny: ReleaseFolder) -> None:
    manifest = tiny.manifest
    assert manifest.select() == manifest.blocks
    assert [block.key.path for block in manifest.select("grasp", split="val")] == ["round-1/grasp/val"]
    assert {block.task for block in manifest.select(["grasp_push"], [1])} == {"grasp_push"}
    for arguments, sentence in (
        ({"tasks": ["push"]}, "has no task push"),
        ({"rounds": [2, 3]}, "has no round 2, 3"),
        ({"split": "test"}, "has no split test"),
    ):
        with pytest.raises(InputError, match=sentence) as caught:
            manifest.select(**arguments)  # type: ignore[arg-type]
        assert caught.value.hint.startswith("it has: ")


def test_a_combination_that_no_block_has_is_an_error(tiny: ReleaseFolder) -> None:
    some = tuple(block for block in tiny.manifest.blocks if (block.task, block.split) != ("grasp", "val"))
    with pytest.raises(InputError, match="no block of this combination"):
        dataclasses.replace(tiny.manifest, blocks=some).select(["grasp"], split="val")


def test_files_of_some_blocks_and_the_card(tiny: ReleaseFolder) -> None:
    manifest = tiny.manifest
    chosen = manifest.select("grasp", split="train")
    files = manifest.files_of(chosen)
    assert {file.block for file in files} == {None, "round-1/grasp/train"}
    assert {file.path for file in files if file.block is None} >= {"LICENSE", "DATASHEET.md"}
    assert len(files) < len(manifest.files)
