"""What is to be said of networks: their data, training and validation, and their rates. A card, and docs/models.md."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from baselines.tae.checkpoint import load_checkpoint
from evaluator.leaderboard.export import markdown_table
from evaluator.leaderboard.row import Row
from evaluator.statistics import format_rate
from rema_data.release.licences import hub_licence, licence_url

__all__ = ["LIMITS", "USE", "model_card", "network_table", "rate_table"]

USE = """\
Baselines to compare with, a start for policies of your own, and a way to collect further data: all in
the world of this repository."""
LIMITS = """\
They were trained on height maps without noise, on objects in the shapes I, L and T with a height of 30 mm,
and on one gripper. They have not seen a real camera or a real arm. What a network says of an action is a score that
orders actions; read it as a probability only as far as the calibration error below goes."""
_NETWORK = (
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
)
_RATE = ("task", "protocol", "success, % [95 %]", "test scenarios")


def network_table(networks: Mapping[str, Path]) -> str:
    """A Markdown table of networks: a line each, from the cards beside the weights. Errors as ``load_checkpoint``."""
    rows = []
    for path in networks.values():
        network, about = load_checkpoint(path)
        config, metrics = about.training, about.metrics
        rows.append(
            [
                path.stem,
                ", ".join(about.skills),
                f"{sum(values.numel() for values in network.parameters()):,}",
                f"{about.release} ({about.release_sha256[:12]})",
                f"{_said(config, 'updates', ',')} x {_said(config, 'batch_size')}, "
                f"{config.get('precision', 'float32')}",
                f"{_said(config, 'learning_rate', 'g')}, {_said(config, 'schedule')}",
                _said(config, "seed"),
                f"{about.updates:,}",
                _said(metrics, "auc", ".3f"),
                _said(metrics, "calibration_error", ".3f"),
            ]
        )
    return markdown_table(_NETWORK, rows)


def _said(values: Mapping[str, object], name: str, form: str = "") -> str:
    """A value of a card, which another program may have written without it."""
    found = values.get(name)
    try:
        return "-" if found is None else format(found, form)
    except (TypeError, ValueError):
        return str(found)


def rate_table(policy: str, rows: Iterable[Row]) -> str:
    """A Markdown table of the verified rows of a policy on the leaderboard; empty where there is none."""
    rates = [
        [row.task, row.protocol, format_rate(row.successes, row.episodes), f"{row.episodes:,}"]
        for row in rows
        if row.policy == policy and row.verified and row.successes is not None
    ]
    return markdown_table(_RATE, rates) if rates else ""


def model_card(title: str, about: str, licence: str, networks: Mapping[str, Path], rates: str) -> str:
    """README.md of networks in a repository of the hub; ``rates`` is a table, or empty."""
    lines = [
        "---",
        f"license: {hub_licence(licence)}",
        "library_name: rema",
        "pipeline_tag: robotics",
        "tags:",
        "- manipulation",
        "- tool-use",
        "- safetensors",
        "---",
        "",
        f"# {title}",
        "",
        about,
        "",
        "```sh",
        "pip install rema",
        "rema evaluate tae --checkpoint FOLDER --task grasp    # FOLDER: a copy of this repository",
        "```",
        "",
        "## Networks",
        "",
        network_table(networks),
        "",
        "Each is a pair of files: `NAME.safetensors` holds the weights, and `NAME.json` says what they are. "
        "`sha256sum --check SHA256SUMS` checks the copy.",
        "",
        "## Rates on the frozen test scenarios",
        "",
        rates or "Not on the leaderboard yet: the command above measures one.",
        "",
        "## Use and limits",
        "",
        f"{USE.replace('this repository', '[rema](https://pypi.org/project/rema)')} {LIMITS}",
        "",
        "## Licence",
        "",
        f"[{licence}]({licence_url(licence)})",
        "",
    ]
    return "\n".join(lines)
