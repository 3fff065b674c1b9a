"""The recursion: collect, train, collect with what was trained, round after round (paper, section 4.4).

Every stage leaves something sealed: a release, or a checkpoint. A stage whose product is there is skipped, so the same
command goes on after any interruption; within a stage, collection and training resume by themselves.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from baselines.devices import training_device
from baselines.rounds.collect import collect
from baselines.rounds.recursion_plan import NetworkPlan, RecursionPlan, RoundPlan, networks_folder
from baselines.rounds.sealed import PLAYERS, STAGES, check_sealed, note, players_of
from baselines.train.loop import train, trained
from evaluator.policy.shipped import CHECKPOINTS, publish_checkpoint
from rema_data.errors import InputError, MissingFileError
from rema_data.loader.release import load
from rema_data.loader.subsets import freeze_subsets
from rema_data.progress import Progress, Silent
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST, parse_manifest
from rema_data.release.registry import register
from rema_data.release.subsets import large_enough

__all__ = ["Stage", "publish", "recurse", "train_network"]


@dataclass(frozen=True, slots=True)
class Stage:
    """A step of the recursion, ``collect NAME`` or ``train FOLDER/NAME``, and the seconds that this run spent on it."""

    round: int
    what: str
    already: bool
    seconds: float


def recurse(
    plan: RecursionPlan,
    releases: Path,
    *,
    progress: Progress | None = None,
    workers: int | None = None,
    device: str = "cpu",
) -> Iterator[Stage]:
    """Carry out a plan, from the first stage whose product is not there, and yield every stage when it is done.

    Networks go to the folder ``checkpoints`` in ``releases``. ``workers`` is the number of simulation processes, by
    default one a core; ``device`` is that of the trainings.

    Raises what ``collect`` and ``train`` raise; what is finished stays. Raises InputError or MissingFileError, before
    anything is done, without a device, a reused round or the networks of another recursion; and RunMismatchError where
    a release or network of that name is from another plan (see ``check_sealed`` and ``trained``).
    """
    recursion = _Recursion(plan, releases, progress, device, workers)
    for entry in plan.rounds:
        if not (releases / entry.release / MANIFEST).is_file():
            recursion.check_possible(entry)
    for entry in plan.rounds:
        yield recursion.collect(entry)
        for network in entry.networks:
            yield recursion.train(entry, network)


def train_network(
    plan: RecursionPlan, releases: Path, place: str, *, progress: Progress | None = None, device: str = "cpu"
) -> Stage:
    """Train the network ``FOLDER/NAME`` of a plan alone, so that several machines or processes share a round.

    Raises InputError where the plan has no such network, MissingFileError where its round is not sealed yet.
    """
    networks = {f"{one.folder}/{one.name}": (entry, one) for entry in plan.rounds for one in entry.networks}
    if place not in networks:
        raise InputError(f"{plan.path} has no network {place!r}", hint=f"it has: {', '.join(networks)}")
    entry, network = networks[place]
    recursion = _Recursion(plan, releases, progress, device)
    if recursion.sealed(entry) is None:
        raise MissingFileError(
            f"round {entry.number}, on which {place} is trained, is not sealed yet",
            hint=f"collect it first: rema rounds {plan.path}",
        )
    return recursion.train(entry, network)


def publish(plan: RecursionPlan, releases: Path) -> None:
    """Enter the last release, its fixed subsets, and the networks of the plan's policies in the manifests.

    Raises MissingFileError where a stage is not done yet, InputError where the name is published with other content.
    """
    path = releases / plan.name / MANIFEST
    networks = [network for entry in plan.rounds for network in entry.networks]
    files = [releases / CHECKPOINTS / plan.name / network.folder / f"{network.name}.json" for network in networks]
    for file in (path, *files):
        if not file.is_file():
            raise MissingFileError(f"{file} is not there yet", hint=f"finish it first: rema rounds {plan.path}")
    manifest = parse_manifest(path.read_bytes(), str(path))
    register(manifest, plan.continues)
    if large_enough(manifest):
        freeze_subsets(load(path.parent))
    for one in plan.policies:
        place = f"{plan.name}/{one.folder}"
        publish_checkpoint(one.policy, place, releases / CHECKPOINTS / place, one.task)


class _Recursion:
    def __init__(
        self,
        plan: RecursionPlan,
        releases: Path,
        progress: Progress | None,
        device: str,
        workers: int | None = None,
    ) -> None:
        self.plan, self.releases, self.progress = plan, releases, progress or Silent()
        self.device, self.workers = device, workers
        training_device(device)  # hours of collection may come before the first training
        self.networks = releases / CHECKPOINTS / plan.name

    def check_possible(self, entry: RoundPlan) -> None:
        """Raise where a round that is not there yet lacks what no earlier stage makes."""
        if entry.collection is None:
            raise MissingFileError(
                f"round {entry.number} is reused from {entry.release}, which is not in {self.releases}",
                hint="collect that recursion first, or fetch it; its last round has its name, and is not reused",
            )
        self.plan.outline(entry.number).check_devices()
        for place in entry.played_by:
            if not place.startswith(f"{self.plan.name}/"):
                networks_folder(place, self.releases)

    def sealed(self, entry: RoundPlan) -> ReleaseFolder | None:
        """The release of a round, where it is there and holds what the plan says."""
        path = self.releases / entry.release / MANIFEST
        if not path.is_file():
            return None
        release = ReleaseFolder(parse_manifest(path.read_bytes(), str(path)), self.releases)
        if entry.collection is not None:
            check_sealed(self.plan, entry, release)
        return release

    def collect(self, entry: RoundPlan) -> Stage:
        started = time.perf_counter()
        if self.sealed(entry) is not None:
            return self.stage(entry, f"collect {entry.release}", started, already=True)
        if entry.played_by:  # noted before the first episode: a kill between the seal and a note would lose it
            note(self.networks / PLAYERS, entry.release, players_of(entry, self.releases))
        planned = self.plan.collection(entry.number, self.releases)
        collect(planned, self.releases, workers=self.workers, progress=self.progress)
        return self.stage(entry, f"collect {entry.release}", started)

    def train(self, entry: RoundPlan, network: NetworkPlan) -> Stage:
        started, release = time.perf_counter(), load(self.releases / entry.release, progress=self.progress)
        where = network.config, self.networks / network.folder, network.name
        already = trained(release, *where) is not None
        if not already:
            train(release, *where, device=self.device, progress=self.progress)
        return self.stage(entry, f"train {network.folder}/{network.name}", started, already)

    def stage(self, entry: RoundPlan, what: str, started: float, already: bool = False) -> Stage:
        """A finished stage; the run that finished it notes how long it took."""
        stage = Stage(entry.number, what, already, time.perf_counter() - started)
        if not already:
            note(self.networks / STAGES, what, {"round": entry.number, "seconds": round(stage.seconds, 1)})
        return stage
