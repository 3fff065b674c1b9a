"""README.md of a release in a repository: front matter that the hub reads, and how to use the files."""

from __future__ import annotations

import json

from rema_data.convert.huggingface import column_lines, config_lines
from rema_data.release.datasheet import has_varied
from rema_data.release.licences import hub_licence, licence_url
from rema_data.release.manifest import Manifest
from rema_data.store.block import EPISODES, STEPS
from rema_data.store.keys import SPLITS

__all__ = ["VIEWER", "dataset_card", "size_category"]

VIEWER = "viewer"
"""Folder of the Parquet files with maps, which the hub's viewer and ``datasets`` read."""
_LETTERS = ("", "K", "M", "B", "T")


def size_category(rows: int) -> str:
    """What the hub calls a size: between two powers of ten, ``10K<n<100K``; it has none below 1,000."""
    if rows < 1000:
        return "n<1K"
    digits = len(str(rows)) - 1
    return f"{_power(digits)}<n<{_power(digits + 1)}"


def _power(digits: int) -> str:
    return f"{10 ** (digits % 3)}{_LETTERS[digits // 3]}"


def dataset_card(manifest: Manifest, repository: str, viewer: bool) -> str:
    """The card of a release for the repository ``repository``; ``viewer``: the Parquet files with maps are there too.

    JSON strings are valid YAML.
    """
    steps = manifest.counts["steps"]
    tasks = list(dict.fromkeys(block.task for block in manifest.blocks))
    split = manifest.blocks[0].split
    configs = config_lines(manifest.blocks, f"{VIEWER}/") if viewer else _table_configs(manifest)
    first = tasks[0] if viewer else "steps"
    lines = [
        "---",
        f"pretty_name: {json.dumps(manifest.title)}",
        f"license: {hub_licence(manifest.license)}",
        "size_categories:",
        f"- {size_category(steps)}",
        "task_categories:",
        "- robotics",
        "tags:",
        "- manipulation",
        "- tool-use",
        "- offline-learning",
        "- simulation",
        *configs,
        "---",
        "",
        f"# {manifest.title}",
        "",
        manifest.description,
        "",
        f"Release `{manifest.name}`, sha256 `{manifest.sha256}`: {manifest.counts['episodes']:,} episodes, "
        f"{steps:,} executed steps.",
        "",
        "## Use",
        "",
        "With [rema](https://pypi.org/project/rema), whose files these are, byte for byte:",
        "",
        "```sh",
        'pip install "rema[hf]"',
        f"rema download {manifest.name} --source hf://datasets/{repository}",
        "```",
        "",
        "A release that this version of rema does not list needs its manifest too: "
        f"`--manifest {manifest.name}/manifest.json`. A copy of the whole repository is a source (`--source FOLDER`), "
        "and `rema verify FOLDER` checks every byte of it.",
        "",
        "With `datasets`:",
        "",
        "```python",
        "import datasets",
        "",
        f'steps = datasets.load_dataset("{repository}", "{first}", split="{split}")',
        "```",
        "",
        *(column_lines(tasks, "metres", manifest.schema_version) if viewer else _tables(manifest)),
        "",
        "## Files",
        "",
        "| path | content |",
        "|---|---|",
        f"| `{manifest.name}/` | the release: manifest, datasheet, and a folder of tables and maps for every block |",
        *(f"| `{holder}/` | blocks that it shares with that release |" for holder in _others(manifest)),
        *([f"| `{VIEWER}/` | the same steps in Parquet, with maps in metres |"] if viewer else []),
        "| `croissant.json` | the tables and files, in Croissant 1.1 |",
        "| `SHA256SUMS` | of every file: `sha256sum --check SHA256SUMS` |",
        "",
        "## Licence and citation",
        "",
        f"[{manifest.license}]({licence_url(manifest.license)}). Please cite: {manifest.citation} "
        "[CITATION.cff](CITATION.cff) says it for programs.",
        "",
    ]
    return "\n".join(lines)


def _others(manifest: Manifest) -> list[str]:
    return sorted({block.holder for block in manifest.blocks} - {manifest.name})


def _mixed(manifest: Manifest) -> bool:
    """Whether the tables of episodes of an earlier release have other columns: ``datasets`` takes one set of them."""
    return has_varied(manifest) and bool(_others(manifest))


def _tables(manifest: Manifest) -> list[str]:
    text = (
        "The configurations `steps` and `episodes` are the tables of the release, without maps: "
        "the datasheet has their columns."
    )
    return [text + " `episodes-earlier` are those of the blocks that it shares." * _mixed(manifest)]


def _table_configs(manifest: Manifest) -> list[str]:
    every = ["*"]
    groups = [("steps", STEPS, manifest.blocks, every), ("episodes", EPISODES, manifest.blocks, every)]
    if _mixed(manifest):
        own = tuple(block for block in manifest.blocks if block.holder == manifest.name)
        shared = tuple(block for block in manifest.blocks if block.holder != manifest.name)
        groups[1:] = [
            ("episodes", EPISODES, own, [manifest.name]),
            ("episodes-earlier", EPISODES, shared, _others(manifest)),
        ]
    lines = ["configs:"]
    for name, table, blocks, folders in groups:
        lines += [f"- config_name: {name}", "  data_files:"]
        here = {block.split for block in blocks}
        for split in (split for split in SPLITS if split in here):
            paths = [f'"{folder}/round-*/*/{split}/{table}"' for folder in folders]
            lines += [f"  - split: {split}"]
            lines += [f"    path: {paths[0]}"] if len(paths) == 1 else ["    path:", *(f"    - {one}" for one in paths)]
    return lines
