"""Parsers of the dataset, of its tools, and of what trains on it."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import torch

import rema_data
from baselines.rounds.plan import load_plan
from baselines.rounds.recursion_plan import load_recursion
from baselines.rounds.sealed import read_notes
from baselines.rounds.work import Chunk, WorkFolder
from baselines.tae.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from baselines.tae.network import Architecture, TaeNetwork
from baselines.train.state import TrainingState, read_state, write_state
from rema_data.convert import export_release
from rema_data.convert.inbound import import_release
from rema_data.download import download
from rema_data.errors import IntegrityError
from rema_data.json_files import with_digest
from rema_data.loader.record import damaged_files
from rema_data.release.folder import find_release
from rema_data.release.registry import SAMPLE, load_published, published, register
from rema_data.release.subsets import subsets_of
from rema_data.samplers import BalancedSampler
from rema_data.store.block import BlockKey, BlockReader, encode_episodes
from rema_data.store.maps import ARRAYS
from rema_data.testing import make_block, make_release, synthetic_episode
from tests.baselines.rounds.fakes import PLAN
from tests.mutations.parser import Again, Parser

__all__ = ["PARSERS"]

KEY = BlockKey(1, "grasp_push", "train")
MANIFESTS = Path(__file__).resolve().parents[2] / "manifests"
RECURSION = (Path(__file__).resolve().parents[2] / "examples" / "tiny.toml").read_text()
IDENTITY = {"seed": 1}
SMALL = Architecture(width=8)


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def make_published(folder: Path) -> None:
    """A release on this machine, and its entry in the index."""
    (folder / "manifests" / "datasets").mkdir(parents=True)
    made = make_release(folder / "home" / "releases", tasks=("grasp",), episodes=5)
    register(made.manifest)
    _writable(folder)


def make_subsets(folder: Path) -> None:
    """The manifest of the fixed subsets of the sample, beside the index that its release is in."""
    (folder / "manifests" / "subsets").mkdir(parents=True)
    (folder / "manifests" / "datasets").symlink_to(MANIFESTS / "datasets")
    shutil.copy(MANIFESTS / "subsets" / f"{SAMPLE}.json", folder / "manifests" / "subsets")


def read_subsets(folder: Path) -> Any:
    return subsets_of(load_published(SAMPLE))


def _writable(folder: Path) -> None:
    for path in folder.rglob("*"):
        path.chmod(0o755 if path.is_dir() else 0o644)


def publish_again(folder: Path, file: Path) -> None:
    """Enter a forged manifest in the index."""
    index = folder / "manifests" / "datasets" / "index.json"
    index.write_text(json.dumps({"releases": [{"name": "tiny", "sha256": sha256(file)}]}, indent=1) + "\n")
    for place in (index.with_name("tiny.json"), folder / "home" / "releases" / "tiny" / "manifest.json"):
        if place != file:
            shutil.copy(file, place)


def make_unpublished(folder: Path) -> None:
    (folder / "manifests" / "datasets").mkdir(parents=True)
    (folder / "manifests" / "datasets" / "index.json").write_text('{"releases": []}\n')
    make_release(folder / "releases", tasks=("grasp",), episodes=5)
    _writable(folder)


def read_maps(folder: Path) -> Any:
    maps = BlockReader(folder / "block").maps()
    return {name: maps.read(name, 0, maps.rows(name)) for name in ARRAYS}


def make_cache(folder: Path) -> None:
    make_published(folder)
    assert len(rema_data.load("tiny").cache.index)


def read_cache(folder: Path) -> Any:
    cache = rema_data.load("tiny").cache
    assert cache.folder is not None
    damage = damaged_files(cache.folder)
    if damage:
        raise IntegrityError(f"{damage} are damaged", hint="rema doctor --check-caches says so")
    table = rema_data.load("tiny").steps(which="all").table
    return {**vars(cache.maps), "index": np.array(cache.index), "categories": cache.categories, "table": table}


def make_download(folder: Path) -> None:
    """A download that was interrupted: some files are here, one in part."""
    make_published(folder)
    shutil.move(folder / "home" / "releases", folder / "mirror")
    download("tiny", sources=[folder / "mirror"])
    _writable(folder)
    block = folder / "home" / "releases" / "tiny" / "round-1" / "grasp" / "train"
    (block.parents[2] / "manifest.json").unlink()
    half = (block / "steps.parquet").read_bytes()[:3000]
    (block / "steps.parquet").unlink()
    (block / "steps.parquet.part").write_bytes(half)


def read_download(folder: Path) -> Any:
    download("tiny", sources=[folder / "mirror"])
    home = folder / "home" / "releases" / "tiny"
    return {path.relative_to(home).as_posix(): sha256(path) for path in sorted(home.rglob("*")) if path.is_file()}


def make_export(folder: Path) -> None:
    made = make_release(folder / "releases", tasks=("grasp",), episodes=5)
    export_release(made, folder / "exported")
    shutil.rmtree(folder / "releases")


def read_export(folder: Path) -> Any:
    done = import_release([folder / "exported"], folder / "imported")
    if done.differences or done.notes:
        raise IntegrityError(f"imported with remarks: {[*done.differences, *done.notes]}", hint="the import says so")
    return {path.name: sha256(path) for path in sorted((folder / "imported").rglob("*")) if path.is_file()}


CHUNKS = [Chunk(BlockKey(1, "grasp", "train"), start, start + 3) for start in (0, 3)]


def make_work(folder: Path) -> None:
    with WorkFolder.locked(folder / "work", IDENTITY) as work:
        for chunk in CHUNKS:
            episodes = [synthetic_episode(chunk.block, n) for n in range(chunk.start, chunk.stop)]
            work.commit(chunk, encode_episodes(episodes))


def read_work(folder: Path) -> Again:
    with WorkFolder.locked(folder / "work", IDENTITY) as work:
        return Again({chunk.name: work.read(chunk) for chunk in CHUNKS if work.has(chunk)})


def commit_again(folder: Path, file: Path) -> None:
    """Name the hash of a forged chunk in the log."""
    if file.suffix == ".npz":
        from evaluator.run.records import Journal, read_journal

        log = folder / "work" / "log"
        rows = [row for _, row in read_journal(log, "log", dict)]
        for row in rows:
            row["sha256"] = sha256(folder / "work" / "chunks" / f"{row['chunk']}.npz")
        shutil.rmtree(log)
        journal = Journal(log, "log", 1)
        journal.append(rows)
        journal.close()


def make_checkpoint(folder: Path) -> None:
    about = Checkpoint("grasp", ("grasp",), SMALL, "tiny", "0" * 64, {"seed": 0}, {"auc": 0.5}, 10)
    save_checkpoint(folder, "grasp", TaeNetwork(SMALL, torch.Generator().manual_seed(0)).state_dict(), about)


def read_checkpoint(folder: Path) -> Any:
    network, about = load_checkpoint(folder / "grasp")
    return {"weights": network.state_dict(), "about": about}


def name_weights(folder: Path, file: Path) -> None:
    """Name the hash of forged weights in the card."""
    if file.suffix == ".safetensors":
        card = folder / "grasp.json"
        card.write_text(json.dumps(json.loads(card.read_text()) | {"sha256": sha256(file)}, indent=1) + "\n")
    name_content(folder, folder / "grasp.json")


def name_content(folder: Path, file: Path) -> None:
    """Name the hash of forged fields beside them."""
    try:
        content = json.loads(file.read_bytes())
        content.pop("content_sha256", None)
        text = json.dumps(with_digest(content), indent=1)
    except (ValueError, RecursionError, AttributeError, TypeError):
        return  # not even an object
    file.write_text(text + "\n")


def make_state(folder: Path) -> None:
    tensors = {"model/a": torch.arange(40.0), "generator": torch.arange(9, dtype=torch.uint8)}
    facts = {"sampler": {"epoch": 3, "batch": 4}, "history": [[0.5, 0.25]] * 20}
    write_state(folder / "state", IDENTITY, TrainingState(7, tensors, facts))


def read_training(folder: Path) -> Again:
    state = read_state(folder / "state", IDENTITY)
    return Again({} if state is None else {"state": tuple(state)})


def sampler() -> BalancedSampler:
    table = {"task": ["push"] * 9 + ["grasp"] * 9, "success": [True, False, False] * 6}
    return BalancedSampler(table, 4, mode="average", seed=3)


def make_sampler(folder: Path) -> None:
    order = sampler()
    next(iter(order))
    (folder / "sampler.json").write_text(json.dumps(order.state_dict()))


def read_sampler(folder: Path) -> Any:
    order = sampler()
    from tests.mutations.trial import given_json

    order.load_state_dict(given_json(folder / "sampler.json"))
    return [list(batch) for batch in order]


def write(name: str, text: str) -> Any:
    return lambda folder: (folder / name).write_text(text)


HOME = "home/releases/tiny"
PARSERS = (
    Parser(
        "manifest",
        make_published,
        lambda folder: vars(find_release("tiny").manifest),
        (f"{HOME}/manifest.json", "manifests/datasets/tiny.json"),
        {f"{HOME}/manifest.json": "json"},
        publish_again,
    ),
    Parser(
        "manifest of a folder",
        make_unpublished,
        lambda folder: vars(find_release(folder / "releases" / "tiny").manifest),
        ("releases/tiny/manifest.json",),
        {"releases/tiny/manifest.json": "json"},
        checked=False,
    ),
    Parser(
        "index of releases",
        make_published,
        lambda folder: published(),
        ("manifests/datasets/index.json",),
        {"manifests/datasets/index.json": "json"},
        checked=False,
    ),
    Parser(
        "fixed subsets",
        make_subsets,
        read_subsets,
        ("manifests/subsets/*.json",),
        {"manifests/subsets/*.json": "json"},
        checked=False,
    ),
    Parser(
        "table of episodes",
        lambda folder: make_block(folder / "block", KEY, 40),
        lambda folder: BlockReader(folder / "block").episodes(),
        ("block/episodes.parquet",),
        {"block/episodes.parquet": "parquet"},
    ),
    Parser(
        "table of steps",
        lambda folder: make_block(folder / "block", KEY, 40),
        lambda folder: BlockReader(folder / "block").steps(),
        ("block/steps.parquet",),
        {"block/steps.parquet": "parquet"},
    ),
    Parser(
        "maps",
        lambda folder: make_block(folder / "block", KEY, 10),
        read_maps,
        ("block/maps.zarr/**/*",),
        {"block/maps.zarr/**/zarr.json": "json"},
    ),
    Parser("decoded cache", make_cache, read_cache, ("home/decoded/*/*",), {"home/decoded/*/cache.json": "json"}),
    Parser("download", make_download, read_download, (f"{HOME}/**/*.part", f"{HOME}/**/*.parquet")),
    Parser("import of HDF5", make_export, read_export, ("exported/*.hdf5",), slow=4),
    Parser(
        "collection plan",
        write("plan.toml", PLAN),
        lambda folder: load_plan(folder / "plan.toml"),
        ("plan.toml",),
        {"plan.toml": "toml"},
        checked=False,
    ),
    Parser(
        "recursion plan",
        write("plan.toml", RECURSION),
        lambda folder: load_recursion(folder / "plan.toml"),
        ("plan.toml",),
        {"plan.toml": "toml"},
        checked=False,
    ),
    Parser(
        "work folder of a collection",
        make_work,
        read_work,
        ("work/log/*", "work/chunks/*", "work/plan.json"),
        {"work/log/*": "journal", "work/chunks/*": "npz", "work/plan.json": "json"},
        commit_again,
    ),
    Parser(
        "notes of a recursion",
        write("stages.json", json.dumps({"train round-1/grasp": {"seconds": 3.5}, "players": {"a": "b"}}, indent=1)),
        lambda folder: read_notes(folder / "stages.json"),
        ("stages.json",),
        {"stages.json": "json"},
        checked=False,
    ),
    Parser("checkpoint", make_checkpoint, read_checkpoint, ("grasp.*",), {"grasp.json": "json"}, name_weights),
    Parser("state of a training", make_state, read_training, ("state/*",), {"state/*.json": "json"}, name_content),
    Parser(
        "state of a sampler", make_sampler, read_sampler, ("sampler.json",), {"sampler.json": "json"}, checked=False
    ),
)
