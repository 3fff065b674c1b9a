"""Import: an export becomes a release again, with the same hashes where nothing was changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rema_data import interrupts
from rema_data.convert.base import Format, Source
from rema_data.convert.formats import find_format
from rema_data.convert.seal import format_of
from rema_data.errors import InputError, RunMismatchError
from rema_data.leftovers import temporary_folder
from rema_data.progress import Progress, Silent
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST, Manifest, check_name
from rema_data.release.registry import published
from rema_data.release.seal import Description, seal
from rema_data.storage import file_sha256, storage_errors, sync_file, sync_folder, write_atomic
from rema_data.store.block import BlockKey, BlockWriter

__all__ = ["Imported", "import_release"]

_NAMED = 3
"""How many files of a block are named."""


@dataclass(frozen=True, slots=True)
class Imported:
    """What an import made."""

    release: ReleaseFolder
    original: Manifest  # of the release that was exported
    differences: tuple[str, ...]  # why the identity is not the original's; empty where it is
    notes: tuple[str, ...]  # what the files hold that was not imported

    @property
    def identical(self) -> bool:
        """Whether this is the release that was exported, to the last byte."""
        return self.release.manifest.sha256 == self.original.sha256


def import_release(
    sources: Sequence[Path],
    root: Path,
    name: str | None = None,
    format: str | Format | None = None,
    *,
    progress: Progress | None = None,
) -> Imported:
    """Make a release, ``root / name``, of files of one export, or folders of them.

    ``name`` is by default that of the exported release. ``format`` is the name of an installed format, or the format
    itself; by default the one that a sealed folder names, and else robomimic's HDF5.

    Raises InputError where the name cannot be one, or the files are not one export with episodes, MissingFileError for
    a missing file, IntegrityError for one that is not whole or contradicts itself, RunMismatchError where a release of
    that name is there already, and StorageError where the disk is full or may not be written.
    """
    progress = progress or Silent()
    reader = find_format(format or format_of(sources) or "hdf5")
    if name is not None:
        check_name(name)
    with (
        interrupts.held(),
        reader.read(sources, progress) as source,
        storage_errors(root / (name or source.manifest.name)),
    ):
        name = name or source.manifest.name
        if (root / name / MANIFEST).exists():
            raise RunMismatchError(
                f"{root / name} exists: a sealed release is never written to",
                hint="import under another name (--name), or move the old release away",
                path=str(root / name),
            )
        progress.phase("import", source.steps)
        with temporary_folder(f".{name}.importing-", root) as folder:
            staging = folder / name
            staging.mkdir()
            written = _write_blocks(source, staging, progress)
            if not written:
                raise InputError("the files hold no episode of a release", hint="export the release again")
            differences = _compare(source.manifest, staging, written)
            if name == source.manifest.name and not differences:
                _write_card(source, staging)
                missing = [file.path for file in source.manifest.files if not (staging / file.path).is_file()]
                if not missing:
                    release = _restore(source.manifest, staging, root)
                    return Imported(release, source.manifest, (), tuple(source.notes()))
                differences = [f"{path}: not part of the export, written again" for path in missing]
            if name in published():
                raise RunMismatchError(
                    f"{name} is a published release, and this is another one: {differences[0]}",
                    hint="import under another name: --name NAME",
                    name=name,
                )
            if name != source.manifest.name:
                differences.insert(0, f"the name is {name}, not {source.manifest.name}")
            release = seal(
                staging,
                root,
                _description(source.manifest, name),
                list(written),
                fingerprint=dict(source.manifest.fingerprint),  # no plan makes these bytes: it would count as done
            )
        return Imported(release, source.manifest, tuple(differences), tuple(source.notes()))


def _write_blocks(source: Source, staging: Path, progress: Progress) -> dict[BlockKey, int]:
    """Write the blocks of an export; how many episodes each of them has."""
    written = {}
    for key, pieces in source.blocks():
        writer, episodes = BlockWriter(staging / key.path), 0
        for piece in pieces:
            writer.append(*piece)
            episodes += piece.episodes.num_rows
            progress.advance(piece.steps.num_rows)
            interrupts.check()
        writer.close()
        written[key] = episodes
    return written


def _compare(original: Manifest, staging: Path, written: Mapping[BlockKey, int]) -> list[str]:
    """How the blocks that were written differ from those of the original."""
    differences = []
    for block in original.blocks:
        interrupts.check()
        if block.key not in written:
            differences.append(f"{block.key.path}: not part of the export")
            continue
        if written[block.key] != block.episodes:
            differences.append(f"{block.key.path}: {written[block.key]} of {block.episodes} episodes")
            continue
        wanted = {file.path: file.sha256 for file in original.files if file.block == block.key.path}
        folder = staging / block.key.path
        found = {path.relative_to(staging).as_posix(): path for path in sorted(folder.rglob("*")) if path.is_file()}
        other = sorted(
            path for path in wanted.keys() | found if path not in found or file_sha256(found[path]) != wanted.get(path)
        )
        if other:
            listed = ", ".join(path.removeprefix(f"{block.key.path}/") for path in other[:_NAMED])
            rest = f" and {len(other) - _NAMED} more" if len(other) > _NAMED else ""
            differences.append(f"{block.key.path}: other content of {listed}{rest}")
    return differences


def _write_card(source: Source, staging: Path) -> None:
    """Files of the release that belong to no block, as far as the export has them unchanged."""
    for file in source.manifest.files:
        if file.block is None and file.path in source.card:
            path = staging / file.path
            write_atomic(path, source.card[file.path])
            if file_sha256(path) != file.sha256:
                path.unlink()


def _restore(manifest: Manifest, staging: Path, root: Path) -> ReleaseFolder:
    """Put the files of a release where its manifest says, and the manifest last."""
    here = [file for file in manifest.files if (root / file.location).exists()]  # of a parent release, for instance
    for file in here:
        if file_sha256(root / file.location) != file.sha256:
            raise RunMismatchError(
                f"{root / file.location} exists with other content",
                hint="import into another folder, or move the old release away",
                path=str(root / file.location),
            )
    for file in manifest.files:
        if file in here:
            continue
        target = root / file.location
        target.parent.mkdir(parents=True, exist_ok=True)
        path = staging / file.path
        sync_file(path)
        path.chmod(0o444)
        path.replace(target)
        sync_folder(target.parent)
    target = root / manifest.name / MANIFEST
    write_atomic(target, manifest.to_bytes())
    target.chmod(0o444)
    return ReleaseFolder(manifest, root)


def _description(original: Manifest, name: str) -> Description:
    origin = f"Imported from an export of {original.name} ({original.sha256})."
    text = f"{original.description}\n\n{origin}" if original.description else origin
    return Description(name, original.title, text, original.license, original.citation)
