"""The other files of a policy's code: the modules of its folder that it imports. They are read, not run.

As a script, ``python -I -S imports.py FILE`` prints them as a JSON list: the evaluator parses no policy by itself.
"""

from __future__ import annotations

import ast
import json
import sys
from collections.abc import Iterator
from pathlib import Path

__all__ = ["PRODUCT", "outermost_folder", "parsed_modules"]

PRODUCT = ("rema_data", "evaluator")
"""Packages that other digests of the run cover."""


def parsed_modules(file: Path) -> list[Path]:
    """Files that ``file`` (absolute) imports from its own folder or package, and what these import; sorted.

    Of an installed package only its own modules count, as in a checkout. An import that is computed at run time is not
    seen, and a file that is not Python has none.
    """
    root = outermost_folder(file)
    root = root.parent if (root / "__init__.py").is_file() else root
    installed = root != file.parent and any(root.glob("*.dist-info"))
    package = file.relative_to(root).parts[0]
    found: set[Path] = set()
    waiting = [file]
    while waiting:
        at = waiting.pop()
        for name in _imported(at, root):
            if installed and name.partition(".")[0] != package:
                continue
            for path in _files_of(name, root):
                if path != file and path not in found:
                    found.add(path)
                    waiting.append(path)
    return sorted(found)


def outermost_folder(file: Path) -> Path:
    """The folder of the outermost package that ``file`` is a module of; its own folder where it is in no package."""
    folder = file.parent
    while (folder / "__init__.py").is_file() and (folder.parent / "__init__.py").is_file():
        folder = folder.parent
    return folder


def _imported(file: Path, root: Path) -> Iterator[str]:
    """Absolute names of everything that a file may import; a name in it may be a module or something inside of one."""
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError):
        return
    package = file.parent.relative_to(root).parts
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield base
            yield from (f"{base}.{alias.name}" if base else alias.name for alias in node.names)


def _files_of(name: str, root: Path) -> Iterator[Path]:
    """The module of a name below ``root``, with the packages around it."""
    parts = name.split(".")
    if parts[0] in PRODUCT or not all(part.isidentifier() for part in parts):
        return
    for length in range(1, len(parts) + 1):
        place = root.joinpath(*parts[:length])
        for path in (place / "__init__.py", place.with_suffix(".py")):
            if path.is_file():
                yield path


if __name__ == "__main__":
    sys.stdout.write(json.dumps([str(path) for path in parsed_modules(Path(sys.argv[1]))]))
