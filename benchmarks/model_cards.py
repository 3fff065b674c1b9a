"""Write docs/models.md, a card for every policy whose networks come with rema: data, training, rates, use and limits.

    python benchmarks/model_cards.py

Everything measured is read: from the cards beside the weights, the manifests of their releases, and the leaderboard.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tae.checkpoint import load_checkpoint, networks_in
from benchmarks.baseline_tables import markdown
from benchmarks.results import ROOT
from evaluator.leaderboard import leaderboard
from evaluator.leaderboard.row import Row
from evaluator.policy.named import find_named
from evaluator.policy.shipped import shipped_checkpoint, shipped_policies
from evaluator.run.entry import find_entries
from evaluator.statistics import format_rate

PAGE = ROOT / "docs" / "models.md"
TITLE = """# The networks that come with rema

Made by `python benchmarks/model_cards.py`, from the cards beside the weights and from the leaderboard. [The network and
its training](network.md) describes the layers, [the learned baselines](baselines.md) how they came about.

**Intended use.** Baselines to compare with, a start for policies of your own, and a way to collect further data: all in
the world of this repository.

**Limits.** They were trained on height maps without noise, on objects in the shapes I, L and T with a height of 30 mm,
and on one gripper. They have not seen a real camera or a real arm. What a network says of an action is a score that
orders actions; read it as a probability only as far as the calibration error below goes. [The generalisation
suite](suite.md) measures how far they hold where the world is another.

**Licence** of the weights: that of the repository.
"""


def card(policy: str, folder: str, rows: list[Row]) -> list[str]:
    """The section of a policy."""
    named, place = find_named(policy), shipped_checkpoint(policy)
    assert named is not None and place is not None
    networks = []
    for path in networks_in(place).values():
        network, about = load_checkpoint(path)
        config, metrics = about.training, about.metrics
        networks.append(
            [
                path.stem,
                ", ".join(about.skills),
                f"{sum(values.numel() for values in network.parameters()):,}",
                f"{about.release} ({about.release_sha256[:12]})",
                f"{config['updates']:,} x {config['batch_size']}, {config.get('precision', 'float32')}",
                f"{config['learning_rate']:g}, {config['schedule']}",
                str(config["seed"]),
                f"{about.updates:,}",
                f"{metrics['auc']:.3f}",
                f"{metrics['calibration_error']:.3f}",
            ]
        )
    rates = [
        [row.task, row.protocol, format_rate(row.successes, row.episodes), f"{row.episodes:,}"]
        for row in rows
        if row.policy == policy and row.verified and row.successes is not None
    ]
    return [
        f"## `{policy}`",
        f"{named.description} Folder `releases/checkpoints/{folder}`.",
        markdown(
            [
                "network",
                "skills",
                "parameters",
                "data",
                "updates x batch",
                "learning rate",
                "seed",
                "best after",
                "validation AUC",
                "calibration error",
            ],
            networks,
        ),
        markdown(["task", "protocol", "success, % [95 %]", "test scenarios"], rates)
        if rates
        else "These networks have no verified row on the leaderboard yet.",
    ]


def main() -> int:
    """Write the page; says where."""
    rows = list(leaderboard(find_entries(), published=False).rows)
    parts = [TITLE.strip()]
    for policy, (folder, _) in shipped_policies().items():
        parts += card(policy, folder, rows)
    PAGE.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    print(PAGE.relative_to(ROOT))
    return 0


if __name__ == "__main__":
    sys.exit(main())
