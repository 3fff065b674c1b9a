"""A published release whose files are random bytes, on a mirror, and a machine that has nothing of it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import rema_data.download.fetch as fetch
import rema_data.download.transfer as transfer
from rema_data.release.folder import downloads_folder
from rema_data.release.manifest import BlockEntry, FileEntry, Manifest
from rema_data.release.registry import register
from rema_data.schema import TASKS
from rema_data.store.block import BlockKey

BLOCK = "round-1/grasp/train"


@dataclass(frozen=True)
class Mirrored:
    """A release and the folder of releases in which its files lie."""

    manifest: Manifest
    folder: Path

    def content(self) -> dict[str, bytes]:
        """Bytes of every file, by location."""
        return {entry.location: (self.folder / entry.location).read_bytes() for entry in self.manifest.files}

    def size(self) -> int:
        """Of all files."""
        return sum(entry.bytes for entry in self.manifest.files)


Publish = Callable[..., Mirrored]


def fetched() -> dict[str, bytes]:
    """Bytes of every file below the downloads folder but for locks and manifests, by location."""
    root = downloads_folder()
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file() and path.suffix != ".lock" and path.name != "manifest.json"
    }


def make_manifest(folder: Path, name: str, files: dict[str, bytes], sources: Sequence[str] = ()) -> Manifest:
    """Write files to ``folder / name``; the manifest that lists them, with empty blocks."""
    entries = []
    for path, data in sorted(files.items()):
        target = folder / name / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(data)
        entries.append(FileEntry(path, len(data), hashlib.sha256(data).hexdigest(), name))
    keys = dict.fromkeys(BlockKey.parse(entry.block) for entry in entries if entry.block)
    blocks = tuple(BlockEntry(*key, 0, 0, 0, 0, ("random",) * len(TASKS[key.task]), name) for key in keys)
    return Manifest(name, name, "Random bytes.", "CC0-1.0", "", blocks, tuple(entries), sources=tuple(sources))


@pytest.fixture(autouse=True)
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty machine: no release published or here, no waiting between attempts. Its home."""
    (tmp_path / "manifests" / "datasets").mkdir(parents=True)
    (tmp_path / "manifests" / "datasets" / "index.json").write_text('{"releases": []}')
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.setenv("NO_PROXY", "127.0.0.1,localhost")
    monkeypatch.delenv("REMA_OFFLINE", raising=False)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(fetch, "local_sources", lambda: ())
    monkeypatch.setattr(transfer, "WAITS_S", (0.0, 0.01, 0.01, 0.01))
    return tmp_path / "home"


@pytest.fixture
def publish(tmp_path: Path) -> Publish:
    """``publish(name, {path: size}, sources=())`` publishes a release whose files lie below ``mirror/``."""

    def make(name: str = "tiny", sizes: dict[str, int] | None = None, sources: Sequence[str] = ()) -> Mirrored:
        chosen = sizes or {f"{BLOCK}/steps.parquet": 200_000, f"{BLOCK}/maps.zarr/zarr.json": 60, "DATASHEET.md": 500}
        rng = np.random.default_rng(7)
        manifest = make_manifest(
            tmp_path / "mirror", name, {path: rng.bytes(size) for path, size in chosen.items()}, sources
        )
        register(manifest)
        return Mirrored(manifest, tmp_path / "mirror")

    return make
