"""The datasheet of a release, after "Datasheets for Datasets" (Gebru et al.), computed from its manifest."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

from rema_data.heights import HEIGHT_ERROR_M, HEIGHT_OFFSET_M, MISSING
from rema_data.release.licences import licence_url
from rema_data.release.manifest import BlockEntry, Manifest
from rema_data.schema import HEIGHT_STEP_M, SEED_SHAPES, TASKS, Failure, Shape
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS, VARIATION, Column, columns_at, may_vary

__all__ = ["column_table", "datasheet", "has_varied"]


def datasheet(manifest: Manifest) -> str:
    """DATASHEET.md of a release; ``manifest`` lists at least the files of its blocks."""
    sections = {
        "Motivation": _MOTIVATION,
        "Composition": _composition(manifest),
        "Collection process": _collection(manifest),
        "Encoding and its error": _encoding(),
        "Splits and the rule against leakage": _SPLITS,
        **({"Varied episodes": _varied()} if has_varied(manifest) else {}),
        "Columns of episodes.parquet": column_table(columns_at(EPISODE_COLUMNS, manifest.schema_version)),
        "Columns of steps.parquet": column_table(columns_at(STEP_COLUMNS, manifest.schema_version)),
        "Uses": _USES,
        "Known issues": _ISSUES,
        "Distribution and licence": _licence(manifest),
        "Maintenance": _MAINTENANCE,
    }
    text = "\n".join(f"## {title}\n\n{body}\n" for title, body in sections.items())
    return f"# {manifest.title}\n\n`{manifest.name}`: {manifest.description}\n\n{text}"


def has_varied(manifest: Manifest) -> bool:
    """Whether something may be changed in the last step of some episodes of a release."""
    return may_vary(manifest.schema_version)


def column_table(columns: Iterable[Column]) -> str:
    """Dictionary of the columns of a table, in Markdown."""
    rows = [
        (f"`{column.name}`", column.type, column.unit, column.frame, "yes" if column.nullable else "", column.meaning)
        for column in columns
    ]
    return _table(("column", "type", "unit", "frame", "null", "meaning"), rows)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], numbers: int = 0) -> str:
    """A Markdown table whose last ``numbers`` columns are right-aligned."""
    rules = ["---"] * (len(head) - numbers) + ["---:"] * numbers
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, rules, *rows))


def _composition(manifest: Manifest) -> str:
    size = {block.key.path: 0 for block in manifest.blocks}
    for file in manifest.files:
        if file.block is not None:
            size[file.block] += file.bytes
    rows = [(*_place(block, manifest), *_counts([block], size[block.key.path])) for block in manifest.blocks]
    for split in sorted({block.split for block in manifest.blocks}):
        blocks = [block for block in manifest.blocks if block.split == split]
        rows.append(("all", "", split, "", *_counts(blocks, sum(size[block.key.path] for block in blocks))))
    rows.append(("all", "", "", "", *_counts(manifest.blocks, sum(size.values()))))
    head = (
        "round",
        "task",
        "split",
        "policy of each step",
        "episodes",
        "successes",
        "%",
        "steps",
        "end effectors",
        "MB",
    )
    steps = "\n".join(f"- `{task}`: {_steps(task)}" for task in TASKS if any(b.task == task for b in manifest.blocks))
    labels = ", ".join(f"`{label.value}`" for label in Failure)
    return "\n\n".join(
        (
            _wrapped(
                "An instance is an episode: one attempt at a task, as its executed steps. It ends at its first failed "
                "step. A step holds what was seen (the height map of the scene; height and mask of the end effector in "
                "two states), the action, success or one failure label, the evidence for it, and the true geometry and "
                "poses of all objects."
            ),
            _table(head, rows, 6),
            _wrapped(
                "*Successes* are episodes whose last step was reached and succeeded. *Steps* are all that were "
                "executed. *End effectors* are different end-effector maps of a block. Steps of the tasks, in order "
                "(what may touch the target):"
            ),
            steps,
            _wrapped(f"Failure labels: {labels}. Nothing is missing from the instances; nothing relates to people."),
        )
    )


def _wrapped(paragraph: str) -> str:
    return textwrap.fill(paragraph, 120, break_long_words=False, break_on_hyphens=False)


def _place(block: BlockEntry, manifest: Manifest) -> tuple[str, ...]:
    held = "" if block.holder == manifest.name else f" (in {block.holder})"
    return f"{block.round}{held}", block.task, block.split, ", ".join(block.policies)


def _counts(blocks: Sequence[BlockEntry], size: int) -> tuple[str, ...]:
    episodes, positives, steps, maps = (
        sum(getattr(block, name) for block in blocks) for name in ("episodes", "positives", "steps", "end_effectors")
    )
    share = f"{100 * positives / episodes:.1f}" if episodes else "-"
    return f"{episodes:,}", f"{positives:,}", share, f"{steps:,}", f"{maps:,}", f"{size / 1e6:.2f}"


def _steps(task: str) -> str:
    return ", ".join(f"{kind.primitive.value} ({kind.embodiment.value})" for kind in TASKS[task])


def _collection(manifest: Manifest) -> str:
    made = [f"- {name}: `{value}`" for name, value in sorted(manifest.fingerprint.items())]
    if manifest.plan_sha256:
        made.append(f"- sha256 of the collection plan: `{manifest.plan_sha256}`")
    if manifest.parent is not None:
        made.append(f"- parent release: {manifest.parent.name}, sha256 `{manifest.parent.sha256}`")
    how = _wrapped(
        "`rema collect` played every episode in the PyBullet world of this project: two KUKA iiwa arms with parallel "
        "grippers beside a table, flat objects shaped like an I, an L or a T. Objects and poses are drawn from a "
        "generator that is keyed by (root seed, task, round, split, episode). The behaviour policy named in the table "
        "chose each action on the grid; its name and the sha256 of its code and weights stand in every step. Policies "
        "that were given the true poses (`scripted`, `reference`) are privileged. The simulator labelled every step; "
        "nobody annotated anything."
    )
    return f"{how}\n\nThe simulator that made the data, by its fingerprint:\n\n" + "\n".join(made)


def _encoding() -> str:
    return _wrapped(
        f"Heights are uint16: metres = {HEIGHT_STEP_M:g} * value - {-HEIGHT_OFFSET_M:g}. They were rounded once, by at "
        f"most {HEIGHT_ERROR_M * 1000:g} mm, when the map was painted; {MISSING} means: no data. Masks are "
        "packed eight pixels to a byte. End-effector maps that are equal to the last bit are stored once in a block. "
        "Every inner chunk of an array carries a CRC-32C, every Parquet page a checksum, and the manifest names the "
        "sha256 of every file."
    )


def _varied() -> str:
    shapes = ", ".join(shape.value for shape in Shape if shape not in SEED_SHAPES)
    return _wrapped(
        "An episode may be varied: one thing is changed in its last step, as in the generalisation suites of "
        "`rema evaluate`: what stands on the table, what is in the hand, what the maps show, where the hand goes, or "
        "how the objects behave. The column `variation` of `episodes.parquet` says what, as JSON. It is null in a "
        "clean episode, and a table without the column has clean episodes only. With it, observation and outcome of "
        "the step can be made again. What this sheet says of the shapes I, L and T, and of maps without noise and "
        f"hands that do not miss, is of clean episodes: varied ones may have objects of the shapes {shapes}, other "
        "sizes, depth noise, and hands beside their goal. Where other loose objects lie beside the target, a grasp "
        "that lifts any one of them, alone, succeeds, and the evidence is of that one. Whether a varied episode can be "
        "solved at all was not looked at. Count them with `rema stats`, and leave them out with the condition "
        f"`{VARIATION} is null`."
    )


def _licence(manifest: Manifest) -> str:
    sources = "".join(f"\n- {source}" for source in manifest.sources)
    places = f"\n\nIt is distributed from:\n{sources}" if manifest.sources else ""
    day = f"\n\nPublished: {manifest.published}." if manifest.published else ""
    return (
        f"Licence: [{manifest.license}]({licence_url(manifest.license)}); see `LICENSE`.{day}\n\n"
        f"Cite as: {manifest.citation}\n\n`CITATION.cff` says it for machines.{places}"
    )


_MOTIVATION = """\
The release exists to learn, offline, which grasps and pushes succeed: with a bare gripper, with a held tool, with two
held sticks, and with an object pinched between them. It follows the ReMa dataset of *Tool as Embodiment for Recursive
Manipulation* (Noguchi, Matsushima, Matsuo, Gu; arXiv 2112.00359), which was not published. It is made anew in another
world and is not that dataset: its numbers need not agree with the paper's."""

_SPLITS = """\
`train` and `val` are parts of the release. Their scenes come from separate parts of the seed space, and no episode
and no scene is in both. The evaluator's scenario lists (`test` and its own `val`) come from other parts again: never
train on them. A split is a property of the episode: its steps are never divided. `rema verify` looks for scenes that
occur in two splits or in a scenario list."""

_USES = """\
Meant for: learning per-pixel success of actions; balanced sampling by task and success; studies of failure labels; a
start for further rounds of collection (`rema collect`). A model trained on it is scored with `rema evaluate`.

Not meant for: claims about real robots without a test on one (the maps have no sensor noise and the arms do not
miss); comparison with the paper's absolute rates (another world); training a policy on columns that it cannot see
when it acts. Geometry and poses of objects are recorded for analysis and are privileged."""

_ISSUES = """\
- **Bare grippers look alike.** The end-effector map of a bare gripper depends on the primitive only: all such steps
  of a block share one map each for grasping and pushing. Equal maps are stored once in a block, and `ee_row` points
  at them.
- **What counts as an example.** The paper's Table 2 sums to 118,870 labelled rows of 108,000 episodes: neither
  episodes nor executed steps. Here a row of `steps.parquet` is one executed step; training examples of a task are its
  last steps (`last`), and tool picks are steps of the skill `grasp`. `rema stats --check-paper` prints both counts
  side by side.
- **Steps with tools are a selection.** They exist only where all tools had been picked, by the policy of those steps.
- **Labels are unbalanced.** Random policies succeed rarely; see the table. Balance them with
  `rema_data.BalancedSampler`.
- **One simulator.** The same scene and action give the same outcome on one build of PyBullet and one family of CPUs;
  another may differ in a last bit that contact amplifies. The fingerprint above names the build."""

_MAINTENANCE = """\
A release never changes. Its identity is the sha256 of `manifest.json`, which lists every file with its size and
sha256; `rema verify` checks them. Corrections and further rounds are new releases with new names, which may share
blocks with this one. Errors are reported to the project that publishes it."""
