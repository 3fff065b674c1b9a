"""What a run must be to have a rank: the full frozen test list, the protocol in force, nothing lost, no peeking."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from evaluator.protocol import ACTION_FLIP_LIMIT, protocol_hash
from evaluator.run.scored import ScoredRun
from evaluator.scenarios import SPLITS, VERSION, manifest_path
from rema_data.manifests import read_manifest

__all__ = ["Obstacle", "infra_limit", "installed_list", "obstacles"]


@dataclass(frozen=True, slots=True)
class Obstacle:
    """Why a run has no rank.

    Attributes
    ----------
    what : str
        The field.
    wanted, found : str
        What it must be, and is.
    reason : str
        Both in a few words, for the table.
    """

    what: str
    wanted: str
    found: str
    reason: str


def installed_list(task: str, split: str) -> tuple[str, int] | None:
    """sha256 and number of scenarios of the frozen list of this installation; None where it has none.

    Raises
    ------
    IntegrityError
        The manifest of the lists cannot be read.
    """
    path = manifest_path(VERSION)
    if not path.is_file():
        return None

    def named(content: Any) -> tuple[str, int] | None:
        entry = content["lists"].get(f"{task}/{split}")
        return None if entry is None else (str(entry["sha256"]), int(entry["count"]))

    return read_manifest(path, "scenario manifest", named)


def infra_limit() -> float:
    """Largest share of episodes that may be lost to the infrastructure."""
    from evaluator.runner.run import INFRA_LIMIT  # loads the engines

    return INFRA_LIMIT


def obstacles(run: ScoredRun) -> list[Obstacle]:
    """Everything that keeps a run from being ranked, the weightiest first; empty for a run that is."""
    found = []
    counts, test = run.counts, SPLITS[0]
    if run.split != test:
        found.append(Obstacle("split", test, run.split, f"{run.split} split"))
    if run.stopped_early:
        found.append(Obstacle("stopped_early", "false", "true", "stopped early"))
    sha256, count = installed_list(run.task, test) or ("", 0)
    if not sha256 or run.marks.scenarios_hash != sha256:
        found.append(Obstacle("scenarios_hash", sha256, run.marks.scenarios_hash, "another scenario list"))
    if counts.episodes != count:
        found.append(
            Obstacle("episodes", str(count), str(counts.episodes), f"{counts.episodes:,} of {count:,} scenarios")
        )
    wanted = protocol_hash(run.task, run.protocol)
    if run.marks.protocol_hash != wanted:
        found.append(Obstacle("protocol_hash", wanted, run.marks.protocol_hash, "another protocol version"))
    if run.unfinished:
        found.append(Obstacle("unfinished", "0", str(run.unfinished), f"{run.unfinished:,} episodes not finished"))
    if counts.infra_errors > infra_limit() * counts.episodes:
        limit = f"at most {int(infra_limit() * counts.episodes)}"
        reason = f"{counts.infra_errors:,} episodes lost to the infrastructure"
        found.append(Obstacle("infra_errors", limit, str(counts.infra_errors), reason))
    if run.nondeterministic:
        reason = "steps with two outcomes"
        found.append(Obstacle("nondeterministic", "0", str(run.nondeterministic), reason))
    if run.audit is not None and run.audit.outcome_flips:
        flips = f"{run.audit.outcome_flips} of {run.audit.outcomes}"
        found.append(Obstacle("audit", "0 outcome flips", flips, f"{flips} repeated outcomes flipped"))
    if run.audit is not None and run.audit.action_flips > ACTION_FLIP_LIMIT * run.audit.actions:
        flips = f"{run.audit.action_flips} of {run.audit.actions}"
        limit = f"at most {ACTION_FLIP_LIMIT:.0%} action flips"
        found.append(Obstacle("actions", limit, flips, f"{flips} repeated questions answered otherwise"))
    if run.audit is None and not run.stopped_early:
        found.append(Obstacle("audit", "repeats of a share of the run", "none", "never repeated"))
    if run.outcomes is None:
        found.append(Obstacle("episodes.parquet", "there", "missing", "no outcomes by scenario"))
    return found
