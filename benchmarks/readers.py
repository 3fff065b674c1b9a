"""Compare what another library sees in an export with the release, and the release with what an import brings back.

The parts that the scripts ``*_reader.py`` share: they differ in the library, and in the names it has for things.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from rich.table import Table

from benchmarks.foreign import THERE, step_digest
from benchmarks.results import finish, parser, target
from rema_data.convert import export_release, import_release
from rema_data.convert.pieces import Piece, read_pieces
from rema_data.release.folder import ReleaseFolder, find_release
from rema_data.schema import TASK_NUMBERS
from rema_data.store.keys import SPLITS

__all__ = ["compare"]

Expected = Callable[[Piece], Iterable[Mapping[str, Any]]]


def _wanted(release: ReleaseFolder, tasks: Iterable[str], expected: Callable[[str], Expected]) -> Iterator[str]:
    for task in sorted(tasks, key=TASK_NUMBERS.__getitem__):
        steps = expected(task)
        for block in sorted(
            release.manifest.select([task]), key=lambda block: (SPLITS.index(block.split), block.round)
        ):
            for piece in read_pieces(release.block(block)):
                for step in steps(piece):
                    yield step_digest(step)


def compare(
    name: str,
    script: str,
    docstring: str | None,
    install: str,
    expected: Callable[[str], Expected],
    facts: Mapping[str, tuple[str, Callable[[Any], bool]]],
    task_of: Callable[[str], str | None] = lambda folder: folder,
) -> int:
    """Export, read there, compare, import again; the exit code is 6 if anything differs.

    Parameters
    ----------
    name : str
        Of the format.
    script : str
        The file that runs in the other environment too.
    install : str
        The command that makes the other environment.
    expected : function
        For a task, a function that gives the values of every step of a piece by the names that the script uses there.
    facts : mapping
        Further facts that the script reports there: the title of a column, and whether a value is as it must be.
    task_of : function
        The task of a folder of an export, None where it holds all of them.
    """
    options = parser(docstring)
    options.add_argument("--release", help="name or folder (default: the newest here)")
    options.add_argument("--task", action="append", help="only this one (repeatable)")
    options.add_argument(
        "--python", default=sys.executable, help=f"of the environment with the other library, made by: {install}"
    )
    arguments = options.parse_args()
    release = find_release(arguments.release)
    table = Table(
        "task", "steps", "different", *(title for title, _ in facts.values()), "steps/s", title=f"{name}, read"
    )
    for column in table.columns[1:]:
        column.justify = "right"
    numbers: dict[str, Any] = {"release": release.manifest.name, "rows": []}
    with tempfile.TemporaryDirectory() as temporary:
        start = time.process_time()
        exported = export_release(release, Path(temporary) / "export", name, tasks=arguments.task)
        numbers["peak_bytes"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024  # on Linux
        steps = sum(file.steps for file in exported)
        numbers["export_steps_per_cpu_s"] = steps / (time.process_time() - start)
        numbers["bytes_per_step"] = sum(file.bytes for file in exported) / steps
        for file in exported:
            seen = _there(arguments.python, script, file.path, Path(temporary), install)
            task = task_of(file.path.name)
            tasks = [task] if task else arguments.task or {block.task for block in release.manifest.blocks}
            wanted = list(_wanted(release, tasks, expected))
            pairs = zip(seen["steps"], wanted, strict=False)
            different = sum(one != other for one, other in pairs) + abs(len(seen["steps"]) - len(wanted))
            wrong = sum(not right(seen[key]) for key, (_, right) in facts.items())
            rate = len(wanted) / seen["seconds"]
            found = [str(seen[key]) for key in facts]
            table.add_row(file.path.name, str(len(wanted)), str(different), *found, f"{rate:,.0f}")
            row = {
                "task": file.path.name,
                "steps": len(wanted),
                "different": different,
                "wrong_facts": wrong,
                "rate": rate,
            }
            numbers["rows"].append(row | {key: seen[key] for key in facts})
            numbers["library"] = seen["library"]
        part = "part" if arguments.task else None  # a part of a published release may not have its name
        imported = import_release([Path(temporary) / "export"], Path(temporary) / "back", part, name)
        beside = ("not part of the export", f"the name is part, not {release.manifest.name}")
        differences = [text for text in imported.differences if not text.endswith(beside)]
    wrong_steps = sum(row["different"] for row in numbers["rows"])
    wrong_facts = sum(row["wrong_facts"] for row in numbers["rows"])
    targets = [
        target("steps that differ", "0", str(wrong_steps), not wrong_steps),
        target("other facts that differ", "0", str(wrong_facts), not wrong_facts),
        target("blocks that differ after the import", "0", str(len(differences)), not differences),
        target(
            "export, steps a second of one core",
            "1,000",
            f"{numbers['export_steps_per_cpu_s']:,.0f}",
            numbers["export_steps_per_cpu_s"] >= 1000,
        ),
    ]
    peak = numbers["peak_bytes"]
    targets.append(target("memory of the export at its peak", "< 1 GB", f"{peak / 1e9:.2f} GB", peak < 1e9))
    notes = [f"read by {numbers['library']}; {numbers['bytes_per_step']:,.0f} bytes a step in the export"]
    mismatch = bool(wrong_steps or wrong_facts or differences)
    return finish(arguments, f"{name}_reader", [table], targets, notes, numbers, mismatch=mismatch)


def _there(python: str, script: str, folder: Path, temporary: Path, install: str) -> dict[str, Any]:
    target_ = temporary / "seen.json"
    done = subprocess.run(
        [python, script, THERE, str(folder), str(target_)], check=False, capture_output=True, text=True
    )
    if done.returncode:
        sys.exit(f"{done.stderr}\nthe export cannot be read there; if the library is missing, install it: {install}")
    found: dict[str, Any] = json.loads(target_.read_text())
    return found
