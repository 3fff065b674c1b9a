"""The order of a verification: manifest, files, then the contents of every block, then what lies between blocks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import partial

import pyarrow as pa

from rema_data.errors import IntegrityError, RemaError
from rema_data.interrupts import check
from rema_data.manifests import manifests_dir
from rema_data.progress import Progress, Silent
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import BlockEntry
from rema_data.store.block import EPISODES, STEPS, BlockReader
from rema_data.store.maps import ARRAYS, MAPS
from rema_data.verify.files import absent_blocks, check_files, check_manifest, check_unexpected
from rema_data.verify.findings import Findings, Report
from rema_data.verify.leakage import Scenes, frozen_lists, read_frozen
from rema_data.verify.maps import check_group, check_maps
from rema_data.verify.tables import check_tables

__all__ = ["verify"]

_UNREADABLE = (RemaError, pa.ArrowException, ValueError, KeyError, OSError)
"""What reading a table can raise on bytes that are not a table."""


def verify(
    release: ReleaseFolder,
    tasks: Iterable[str] | None = None,
    rounds: Iterable[int] | None = None,
    split: str | None = None,
    progress: Progress | None = None,
) -> Report:
    """Check every byte and every invariant of a release, or of some ``tasks``, ``rounds`` or one ``split``.

    By default everything, of a downloaded release everything that has been fetched. What a file says is checked where
    its bytes are the sealed ones; else the file is to be fetched again first.

    Raises
    ------
    InputError
        The release has no such task, round or split.
    """
    chosen = release.manifest.select(tasks, rounds, split)
    absent = () if (tasks, rounds, split) != (None, None, None) else absent_blocks(release, chosen)
    wanted = tuple(block for block in chosen if block not in absent)
    return _Verification(release, wanted, absent, progress or Silent()).run()


@dataclass
class _Verification:
    release: ReleaseFolder
    blocks: tuple[BlockEntry, ...]
    absent: tuple[BlockEntry, ...]
    progress: Progress
    findings: Findings = field(default_factory=Findings)
    scenes: Scenes = field(default_factory=Scenes)
    unread: list[str] = field(default_factory=list)
    fix: str = ""

    def run(self) -> Report:
        self.fix = self.release.repair.contents  # of contents whose bytes are the sealed ones
        entries = self.release.manifest.files_of(self.blocks)
        damaged = check_manifest(self.release, self.findings)
        damaged |= check_files(self.release, entries, self.findings, self.progress)
        check_unexpected(self.release, self.findings)
        self.progress.phase("contents", sum(block.steps + 2 * block.end_effectors for block in self.blocks))
        for block in self.blocks:
            check()
            self.check_block(block, damaged)
        frozen = self.check_scenes()
        return Report(
            self.release.manifest.name,
            self.release.manifest.sha256,
            str(self.release.root),
            tuple(self.findings.listed),
            dict(self.findings.counts),
            {
                "blocks": len(self.blocks),
                "files": len(entries),
                "bytes": sum(file.bytes for file in entries),
                "episodes": sum(block.episodes for block in self.blocks),
                "steps": sum(block.steps for block in self.blocks),
                "end_effectors": sum(block.end_effectors for block in self.blocks),
                "frozen_scenes": frozen,
            },
            absent=[block.key.path for block in self.absent],
            unread=self.unread,
            damaged=sorted(damaged),
        )

    def check_block(self, block: BlockEntry, damaged: set[str]) -> None:
        """Check the contents of the files of a block that have the sealed bytes."""
        reader = self.release.block(block)
        report = partial(self.add, reader)
        prefix = f"{block.holder}/{block.key.path}/"
        here = {location.removeprefix(prefix) for location in damaged if location.startswith(prefix)}
        if here:
            self.unread.append(block.key.path)
        map_rows: dict[str, int] = {}
        whole = {name for name in ARRAYS if not any(path.startswith(f"{MAPS}/{name}/") for path in here)}
        described = {f"{MAPS}/zarr.json", *(f"{MAPS}/{name}/zarr.json" for name in ARRAYS)}.isdisjoint(here)
        if described:
            check_group(reader.folder, report)
            try:
                map_rows = check_maps(reader.maps(), whole, report, self.progress.advance)
            except RemaError as error:
                report("maps", MAPS, "", error.message)
        tables = {}
        for name, read in ((EPISODES, reader.episodes), (STEPS, reader.steps)):
            if name not in here:
                try:
                    tables[name] = read()
                except _UNREADABLE as error:
                    report("table", name, "", error.message if isinstance(error, RemaError) else str(error))
        if STEPS in tables:
            self.scenes.add(str(reader.folder / STEPS), block.split, tables[STEPS])
        if len(tables) == 2:
            gaps = not self.release.manifest.plan_sha256  # what a plan has collected is complete
            check_tables(block, tables[EPISODES], tables[STEPS], map_rows, report, gaps=gaps)

    def add(self, reader: BlockReader, kind: str, file: str, where: str, detail: str) -> None:
        """Report something in the contents of a block whose bytes are the sealed ones."""
        self.findings.add(kind, str(reader.folder / file), detail, where=where, fix=self.fix)

    def check_scenes(self) -> int:
        """Compare the scenes of all blocks with each other and with the frozen lists; the number of frozen scenes."""
        frozen: dict[bytes, str] = {}
        lists = frozen_lists(manifests_dir())
        self.progress.phase("scenario lists", len(lists))
        for path in lists:
            try:
                frozen.update(read_frozen(path))
            except IntegrityError as error:
                self.findings.add("table", str(path), error.message, fix=error.hint)
            self.progress.advance(1)
        self.scenes.check(
            frozen,
            lambda file, where, detail: self.findings.add("leakage", file, detail, where=where, fix=self.fix),
        )
        return len(frozen)
