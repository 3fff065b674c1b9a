"""Round trips: a release in every format and back, step by step the same bytes; speed and memory of both ways.

    python benchmarks/formats.py                                       # all of the newest release, all formats
    python benchmarks/formats.py --format rlds --task push

An export reads back what it wrote, and an import compares every block with the hashes of the release. Each way runs in
a process of its own, on one core; rates count the time of the processor.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.table import Table

from benchmarks.results import finish, parser, target
from rema_data.convert import export_release, import_release
from rema_data.plugins import installed
from rema_data.release.folder import find_release
from rema_data.release.manifest import Manifest

RATE, PEAK_GB = 1000, 1.0
PART = "part"
"""Name of what comes back of some tasks of a published release, which may not have its name."""


@dataclass(frozen=True)
class Way:
    """An export or an import."""

    steps: int
    differences: int  # blocks with other bytes
    size: int  # bytes of an export
    cpu_s: float
    peak_bytes: int

    @property
    def rate(self) -> float:
        """Steps a second of one core."""
        return self.steps / self.cpu_s


def export(name: str, release: str | None, tasks: Sequence[str] | None, folder: Path) -> Way:
    """Write an export."""
    start = _spent()
    files = export_release(find_release(release), folder, name, tasks=tasks)
    steps, size = sum(file.steps for file in files), sum(file.bytes for file in files)
    return Way(steps, 0, size, _spent() - start, _peak())


def bring_back(name: str, release: str | None, tasks: Sequence[str] | None, folder: Path, target_: Path) -> Way:
    """Import an export, and compare what came back with the release."""
    start = _spent()
    imported = import_release([folder], target_, PART if tasks else None, name)
    spent = _spent() - start
    wanted, found = find_release(release).manifest, imported.release.manifest
    blocks = wanted.select(tasks)
    other = sum(_sums(wanted, block.key.path) != _sums(found, block.key.path) for block in blocks)
    if not tasks and not imported.identical:
        other = max(other, 1)
    return Way(sum(block.steps for block in blocks), other, 0, spent, _peak())


def _sums(manifest: Manifest, block: str) -> dict[str, str]:
    return {file.path: file.sha256 for file in manifest.files if file.block == block}


def _spent() -> float:
    """Time of the processor of this process, and of those that it has waited for, s."""
    return sum(os.times()[:4])


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024  # on Linux


def main() -> int:
    """Measure, print, write."""
    options = parser(__doc__)
    options.add_argument("--release", help="name or folder (default: the newest here)")
    options.add_argument("--format", action="append", help="only this one (repeatable)")
    options.add_argument("--task", action="append", help="only this one (repeatable)")
    arguments = options.parse_args()
    release = find_release(arguments.release)
    formats = arguments.format or sorted(installed("rema.formats"))
    ways = ("exported, steps/s", "peak, GB", "bytes a step", "imported, steps/s", "peak, GB")
    table = Table("format", "steps", "blocks that differ", *ways, title=f"{release.manifest.name}, there and back")
    for column in table.columns[1:]:
        column.justify = "right"
    targets, numbers, differences = [], {}, 0
    for name in formats:
        with (
            tempfile.TemporaryDirectory() as temporary,
            ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), max_tasks_per_child=1) as fresh,
        ):
            there = Path(temporary) / "there"
            out = fresh.submit(export, name, arguments.release, arguments.task, there).result()
            back = fresh.submit(
                bring_back, name, arguments.release, arguments.task, there, Path(temporary) / "back"
            ).result()
        if out.steps != back.steps:
            sys.exit(f"{name}: {out.steps} steps were exported, and the release has {back.steps}")
        differences += back.differences
        numbers[name] = {"export": asdict(out), "import": asdict(back)}
        table.add_row(
            name,
            f"{back.steps:,}",
            f"{back.differences}",
            f"{out.rate:,.0f}",
            f"{out.peak_bytes / 1e9:.2f}",
            f"{out.size / out.steps:,.0f}",
            f"{back.rate:,.0f}",
            f"{back.peak_bytes / 1e9:.2f}",
        )
        peak = out.peak_bytes / 1e9
        targets += [
            target(f"{name}: export, steps a second of one core", f"{RATE:,}", f"{out.rate:,.0f}", out.rate >= RATE),
            target(f"{name}: export, memory at its peak", f"< {PEAK_GB:.0f} GB", f"{peak:.2f} GB", peak < PEAK_GB),
        ]
    targets.insert(0, target("blocks that differ", "0", f"{differences}", not differences))
    return finish(arguments, "formats", [table], targets, [], numbers, mismatch=bool(differences))


if __name__ == "__main__":
    sys.exit(main())
