"""Write docs/models.md, a card for every policy whose networks come with rema: data, training, rates, use and limits.

    python benchmarks/model_cards.py

Everything measured is read: from the cards beside the weights, the manifests of their releases, and the leaderboard.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.publish.model_card import LIMITS, USE, network_table, rate_table
from baselines.tae.checkpoint import networks_in
from benchmarks.results import ROOT
from evaluator.leaderboard import leaderboard
from evaluator.leaderboard.row import Row
from evaluator.policy.named import find_named
from evaluator.policy.shipped import Shipped, shipped_checkpoint, shipped_policies
from evaluator.run.entry import find_entries

PAGE = ROOT / "docs" / "models.md"
CHECKPOINTS = ROOT / "releases" / "checkpoints"
TITLE = f"""# The networks that come with rema

Made by `python benchmarks/model_cards.py`, from the cards beside the weights and from the leaderboard. [The network and
its training](network.md) describes the layers, [the learned baselines](baselines.md) how they came about.

**Intended use.** {USE}

**Limits.** {LIMITS} [The generalisation
suite](suite.md) measures how far they hold where the world is another.

**Licence** of the weights: MIT.
"""


def card(policy: str, shipped: Shipped, rows: list[Row]) -> list[str]:
    """The section of a policy: its networks, those of single tasks beside them, and its rates."""
    named = find_named(policy)
    assert named is not None
    parts = [f"## `{policy}`", f"{named.description} Folder `releases/checkpoints/{shipped.folder}`."]
    for task in (None, *shipped.tasks):
        place = shipped_checkpoint(policy, task)
        assert place is not None
        if task is not None:
            parts.append(f"In `{task}`, other networks play: `releases/checkpoints/{shipped.of(task).folder}`.")
        parts.append(network_table(networks_in(place)))
    return [*parts, rate_table(policy, rows) or "These networks have no verified row on the leaderboard yet."]


def others() -> list[str]:
    """The section of the networks that no policy has: those of earlier releases, and of single rounds."""
    played = {folder for shipped in shipped_policies().values() for folder in (shipped.folder, *_folders(shipped))}
    found = sorted({path.parent.relative_to(CHECKPOINTS).as_posix() for path in CHECKPOINTS.rglob("*.safetensors")})
    folders = [folder for folder in found if folder not in played]
    return [
        "## Other networks",
        "A clone also has the networks of earlier releases and of single rounds. Each plays by its folder: "
        f"`rema evaluate tae --checkpoint releases/checkpoints/{folders[0]} --task grasp`.",
        "\n".join(f"- `releases/checkpoints/{folder}`" for folder in folders),
    ]


def _folders(shipped: Shipped) -> list[str]:
    return [shipped.of(task).folder for task in shipped.tasks]


def main() -> int:
    """Write the page; says where."""
    rows = list(leaderboard(find_entries(), published=False).rows)
    parts = [TITLE.strip()]
    for policy, shipped in shipped_policies().items():
        parts += card(policy, shipped, rows)
    parts += others()
    PAGE.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    print(PAGE.relative_to(ROOT))
    return 0


if __name__ == "__main__":
    sys.exit(main())
