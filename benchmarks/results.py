"""What every benchmark hands on: its numbers as JSON, with the command and the machine they came from."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from evaluator.sim.bullet import bullet_version

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"

PAGE_WIDTH = 140
MISSED_TARGET = 6
"""Exit code of a benchmark that found a mismatch, or with ``--check`` one that misses its target."""


def parser(docstring: str | None) -> argparse.ArgumentParser:
    """A parser with the options that all benchmarks share: ``--json`` and ``--check``."""
    made = argparse.ArgumentParser(description=docstring, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--json", type=Path, metavar="FILE", help="also write the numbers to FILE, for report.py")
    made.add_argument("--check", action="store_true", help=f"exit with {MISSED_TARGET} if a target is missed")
    return made


def machine() -> dict[str, Any]:
    """The machine and the software, as far as they decide about speed."""
    return {
        "cpu": _cpu_model(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "pybullet": bullet_version(),
        "numpy": version("numpy"),
        "load_average": round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None,
    }


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or "unknown"
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or "unknown"


def finish(
    arguments: argparse.Namespace,
    name: str,
    tables: list[Table],
    targets: list[dict[str, Any]],
    notes: list[str],
    numbers: dict[str, Any],
    *,
    mismatch: bool = False,
) -> int:
    """Print what was measured, write the JSON file, and return the exit code.

    Parameters
    ----------
    arguments : argparse.Namespace
        From a parser of this module.
    name : str
        Of the benchmark.
    tables : list of rich.table.Table
    targets : list of dict
        From ``target``.
    notes : list of str
        Sentences that belong to the numbers.
    numbers : dict
        Everything measured, JSON-ready.
    mismatch : bool
        Whether something that must be equal was not: a failure even without ``--check``.
    """
    console = Console()
    if not console.is_terminal:
        console = Console(width=PAGE_WIDTH)
    for table in tables:
        console.print(table)
    if targets:
        verdicts = Table("what", "target", "measured", "", title="targets")
        for row in targets:
            verdicts.add_row(row["what"], row["wanted"], row["measured"], "met" if row["reached"] else "MISSED")
        console.print(verdicts)
    for note in notes:
        console.print(note, highlight=False)
    if arguments.json:
        content = {
            "benchmark": name,
            "command": shown_command(sys.argv),
            "machine": machine(),
            "tables": [as_rows(table) for table in tables],
            "targets": targets,
            "notes": notes,
            "numbers": numbers,
        }
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    missed = arguments.check and not all(row["reached"] for row in targets)
    return MISSED_TARGET if mismatch or missed else 0


def target(what: str, wanted: str, measured: str, reached: bool) -> dict[str, Any]:
    """One line of the table of targets."""
    return {"what": what, "wanted": wanted, "measured": measured, "reached": bool(reached)}


def as_rows(table: Table) -> dict[str, Any]:
    """Title, header and cells of a table, as strings without markup."""
    columns = [[Text.from_markup(str(cell)).plain for cell in column.cells] for column in table.columns]
    header = [str(column.header) for column in table.columns]
    return {
        "title": str(table.title or ""),
        "header": header,
        "rows": [list(row) for row in zip(*columns, strict=True)],
    }


def shown_command(argv: list[str]) -> str:
    """The command as a reader would repeat it from the repository's root, without ``--json FILE``."""
    script = Path(argv[0])
    if script.is_absolute() and script.is_relative_to(ROOT):
        script = script.relative_to(ROOT)
    words = list(argv[1:])
    for position, word in enumerate(words):
        if word == "--json":
            del words[position : position + 2]
            break
    return " ".join(["python", script.as_posix(), *words])
