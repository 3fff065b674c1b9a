"""Draw the rooms of the code into docs/architecture.md: what each holds, and which room imports which.

    python benchmarks/rooms.py

The imports are those that import-linter checks (grimp reads them). An arrow that follows from others is left out, so
that the drawing shows the layers: a room may import every room below it that it can reach.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Mapping
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import grimp

from benchmarks.leaderboard import markdown_table
from benchmarks.results import ROOT
from rema_data.storage import write_atomic

PAGE = ROOT / "docs" / "architecture.md"
START = "<!-- rooms: made by benchmarks/rooms.py -->"
END = "<!-- end of rooms -->"
PACKAGES = ("rema_data", "evaluator", "baselines")


def room_of(module: str) -> str:
    """``evaluator.run`` for a module of that room; ``rema_data`` and ``baselines`` are one room each."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] == "evaluator" and len(parts) > 1 else parts[0]


def room_imports() -> dict[str, set[str]]:
    """Rooms that each room imports, the lowest rooms first."""
    graph = grimp.build_graph(*PACKAGES)
    found: dict[str, set[str]] = {room_of(module): set() for module in graph.modules}
    for module in graph.modules:
        for target in graph.find_modules_directly_imported_by(module):
            if room_of(target) != room_of(module):
                found[room_of(module)].add(room_of(target))
    ordered: dict[str, set[str]] = {}
    while len(ordered) < len(found):
        ready = sorted(room for room in found if room not in ordered and found[room] <= ordered.keys())
        if not ready:
            raise SystemExit(f"rooms import each other: {', '.join(sorted(found.keys() - ordered.keys()))}")
        ordered |= {room: found[room] for room in ready}
    return ordered


def reduced(imports: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """The same without the arrows that follow from others."""
    reach: dict[str, set[str]] = {}
    for room, targets in imports.items():  # lowest first
        reach[room] = targets.union(*(reach[target] for target in targets))
    return {
        room: {one for one in targets if not any(one in reach[other] for other in targets if other != one)}
        for room, targets in imports.items()
    }


def files_of(room: str) -> list[Path]:
    """Python files of a room."""
    place = ROOT / room.replace(".", "/")
    if place.is_dir():
        loose = room == "evaluator"  # its rooms are listed by themselves
        return sorted(place.glob("*.py") if loose else place.rglob("*.py"))
    return [place.with_suffix(".py")]


def purpose(room: str) -> str:
    """First sentence of the room's docstring."""
    place = ROOT / room.replace(".", "/")
    file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
    text = " ".join((ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").split("\n\n")[0].split())
    return text.partition(". ")[0].rstrip(".:").replace("``", "`")


def drawing(imports: Mapping[str, set[str]]) -> str:
    """The rooms and their arrows, in the language of Mermaid."""
    lines = ["```mermaid", "flowchart BT"]
    lines += [f'    {room.replace(".", "_")}["{room}"]' for room in imports]
    for room, targets in reduced(imports).items():
        lines += [f"    {room.replace('.', '_')} --> {target.replace('.', '_')}" for target in sorted(targets)]
    return "\n".join([*lines, "```"])


def section() -> str:
    """The drawing and the table."""
    imports = room_imports()
    rows = []
    for room in imports:
        files = files_of(room)
        count = sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)
        rows.append([f"`{room}`", str(len(files)), f"{count:,}", purpose(room)])
    return drawing(imports) + "\n\n" + markdown_table(["room", "modules", "lines", "what it holds"], rows)


def main() -> None:
    text = PAGE.read_text(encoding="utf-8")
    head, found, rest = text.partition(START)
    _, closed, tail = rest.partition(END)
    if not (found and closed):
        raise SystemExit(f"{PAGE} has no place for the rooms: add the lines {START} and {END}")
    write_atomic(PAGE, f"{head}{START}\n\n{section()}\n\n{END}{tail}".encode())
    print(PAGE)


if __name__ == "__main__":
    main()
