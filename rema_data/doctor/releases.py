"""The releases that are on this machine."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rema_data.errors import RemaError
from rema_data.release.folder import ReleaseFolder, downloads_folder, local_sources
from rema_data.release.manifest import MANIFEST, parse_manifest
from rema_data.release.registry import load_published, published

__all__ = ["ReleaseState", "local_releases"]


@dataclass(frozen=True)
class ReleaseState:
    """A release on this machine."""

    name: str
    path: str
    identity: str  # published, not published, not the published one, or why the manifest cannot be read
    blocks: int  # that are here whole
    blocks_total: int
    bytes: int  # of the files that are here
    folder: ReleaseFolder | None  # None where the manifest cannot be read

    @property
    def ok(self) -> bool:
        """Whether the release is what its name says."""
        return self.identity in ("published", "not published")


def local_releases() -> tuple[ReleaseState, ...]:
    """Releases in the folders where rema looks for them; the published ones in the order of their publication."""
    index = published()
    found = []
    for root in dict.fromkeys(path.resolve() for path in (downloads_folder(), *local_sources()) if path.is_dir()):
        names = {path.parent.name for path in root.glob(f"*/{MANIFEST}")}
        names |= {name for name in index if (root / name).is_dir()}
        found += [_release_state(root, name, index.get(name)) for name in names]
    order = {name: position for position, name in enumerate(index)}
    return tuple(sorted(found, key=lambda state: (order.get(state.name, len(order)), state.path)))


def _release_state(root: Path, name: str, known: str | None) -> ReleaseState:
    path = root / name / MANIFEST
    try:
        manifest = parse_manifest(path.read_bytes(), str(path)) if path.is_file() else load_published(name)
    except RemaError as error:
        return ReleaseState(name, str(root / name), error.message, 0, 0, 0, None)
    identity = "published" if manifest.sha256 == known else "not published"
    if known not in (None, manifest.sha256) or manifest.name != name:
        identity = "not the published one" if manifest.name == name else f"the folder of {manifest.name}, renamed"
    folder = ReleaseFolder(manifest, root)
    here = sum(file.bytes for file in manifest.files if folder.has(file))
    return ReleaseState(name, str(root / name), identity, len(folder.blocks()), len(manifest.blocks), here, folder)
