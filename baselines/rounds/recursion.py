"""The recursion: collect, train, collect with what was trained, round after round (paper, section 4.4).

Every stage leaves something sealed: a release, or a checkpoint. A stage whose product is there is skipped, so the same
command goes on after any interruption; within a stage, collection and training resume by themselves.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

from baselines.devices import check_players, training_device
from baselines.rounds.collect import collect
from baselines.rounds.notes import PLAYERS, STAGES, note
from baselines.rounds.recursion_plan import NetworkPlan, RecursionPlan, RoundPlan, networks_folder
from baselines.rounds.sealed import check_sealed, players_of
from baselines.train.loop import Report, train, trained
from evaluator.policy.shipped import CHECKPOINTS, publish_checkpoint
from rema_data.errors import InputError, MissingFileError
from rema_data.loader.release import Release, load
from rema_data.progress import Progress
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST, parse_manifest
from rema_data.release.registry import register

__all__ = ["Stage", "Watcher", "publish", "recurse", "train_network"]


@dataclass(frozen=True, slots=True)
class Stage:
    """A step of the recursion.

    Attributes
    ----------
    round : int
    what : str
        ``collect NAME`` or ``train FOLDER/NAME``.
    already : bool
        It was done before.
    seconds : float
        That this run spent on it.
    """

    round: int
    what: str
    already: bool
    seconds: float


class Watcher(Protocol):
    """Where a recursion says how far it is."""

    @property
    def sink(self) -> Progress:
        """Progress of collections."""
        ...

    def training(self, what: str, updates: int) -> Report:
        """A training begins; what it is to report to."""
        ...

    def done(self, stage: Stage) -> None:
        """A stage is done."""
        ...


def recurse(
    plan: RecursionPlan,
    releases: Path,
    watcher: Watcher,
    *,
    stages: int | None = None,
    workers: int | None = None,
    device: str = "cpu",
) -> list[Stage]:
    """Carry out a plan, from the first stage whose product is not there.

    Parameters
    ----------
    plan : RecursionPlan
    releases : Path
        Folder of releases; networks go to its ``checkpoints`` folder.
    watcher : Watcher
    stages : int, optional
        Stop after so many stages that had something to do.
    workers : int, optional
        Simulation processes; every core by default.
    device : str
        Of the trainings.

    Raises
    ------
    RemaError
        As ``collect`` and ``train``; what is finished stays.
    InputError, MissingFileError
        A device of the trainings, or of a round that is to be played, is not there; or a round that is reused, or
        networks that are to play, of another recursion: before anything is done.
    RunMismatchError
        A release or a network of that name is there, made by another plan: see ``check_sealed`` and ``trained`` for
        what is compared.
    """
    recursion = _Recursion(plan, releases, watcher, workers, device)
    for entry in plan.rounds:
        if not (releases / entry.release / MANIFEST).is_file():
            recursion.check_possible(entry)
    done: list[Stage] = []
    for entry in plan.rounds:
        work: list[Callable[[RoundPlan], Stage]] = [recursion.collect]
        work += [partial(recursion.train, network=network) for network in entry.networks]
        for carry_out in work:
            stage = carry_out(entry)
            done.append(stage)
            watcher.done(stage)
            if stages is not None and sum(not stage.already for stage in done) >= stages:
                return done
    return done


def train_network(plan: RecursionPlan, releases: Path, place: str, watcher: Watcher, device: str = "cpu") -> Stage:
    """Train one network of a plan alone, so that several machines, or processes, share the work of a round.

    Parameters
    ----------
    plan, releases, watcher, device
        As in ``recurse``.
    place : str
        ``FOLDER/NAME`` of the network.

    Raises
    ------
    InputError
        The plan has no such network.
    MissingFileError
        Its round is not sealed yet.
    """
    networks = {f"{one.folder}/{one.name}": (entry, one) for entry in plan.rounds for one in entry.networks}
    if place not in networks:
        raise InputError(f"{plan.path} has no network {place!r}", hint=f"it has: {', '.join(networks)}")
    entry, network = networks[place]
    recursion = _Recursion(plan, releases, watcher, None, device)
    if recursion.sealed(entry) is None:
        raise MissingFileError(
            f"round {entry.number}, on which {place} is trained, is not sealed yet",
            hint=f"collect it first: rema rounds {plan.path}",
        )
    stage = recursion.train(entry, network)
    watcher.done(stage)
    return stage


def publish(plan: RecursionPlan, releases: Path) -> None:
    """Enter the last release, and the networks of the plan's policies, in the manifests.

    Raises
    ------
    MissingFileError
        A stage is not done yet.
    InputError
        A release of that name is published with other content.
    """
    path = releases / plan.name / MANIFEST
    networks = [network for entry in plan.rounds for network in entry.networks]
    files = [releases / CHECKPOINTS / plan.name / network.folder / f"{network.name}.json" for network in networks]
    for file in (path, *files):
        if not file.is_file():
            raise MissingFileError(f"{file} is not there yet", hint=f"finish it first: rema rounds {plan.path}")
    register(parse_manifest(path.read_bytes(), str(path)))
    for policy, folder in plan.policies.items():
        publish_checkpoint(policy, f"{plan.name}/{folder}", releases / CHECKPOINTS / plan.name / folder)


class _Recursion:
    def __init__(self, plan: RecursionPlan, releases: Path, watcher: Watcher, workers: int | None, device: str) -> None:
        self.plan, self.releases, self.watcher = plan, releases, watcher
        self.workers, self.device = workers, device
        training_device(device)  # hours of collection may come before the first training
        self.networks = releases / CHECKPOINTS / plan.name

    def check_possible(self, entry: RoundPlan) -> None:
        """Raise where a round that is not there yet lacks what no earlier stage makes."""
        if entry.collection is None:
            raise MissingFileError(
                f"round {entry.number} is reused from {entry.release}, which is not in {self.releases}",
                hint="collect that recursion first, or fetch it; its last round has its name, and is not reused",
            )
        check_players(self.plan.outline(entry.number).blocks, str(self.plan.path))
        for place in entry.played_by:
            if not place.startswith(f"{self.plan.name}/"):
                networks_folder(place, self.releases)

    def collect(self, entry: RoundPlan) -> Stage:
        what, started = f"collect {entry.release}", time.perf_counter()
        sealed = self.sealed(entry)
        if sealed is None:
            if entry.played_by:  # noted before the first episode: a kill between the seal and a note would lose it
                note(self.networks / PLAYERS, entry.release, players_of(entry, self.releases))
            collect(
                self.plan.collection(entry.number, self.releases),
                self.releases,
                workers=self.workers,
                progress=self.watcher.sink,
            )
        return self.finished(entry.number, what, sealed is not None, started)

    def sealed(self, entry: RoundPlan) -> ReleaseFolder | None:
        """The release of a round, where it is there and holds what the plan says."""
        path = self.releases / entry.release / MANIFEST
        if not path.is_file():
            return None
        manifest = parse_manifest(path.read_bytes(), str(path))
        release = ReleaseFolder(manifest, self.releases)
        if entry.collection is not None:
            check_sealed(self.plan, entry, release)
        return release

    def train(self, entry: RoundPlan, network: NetworkPlan) -> Stage:
        what, started = f"train {network.folder}/{network.name}", time.perf_counter()
        release = self.release(entry)
        folder = self.networks / network.folder
        already = trained(release, network.config, folder, network.name) is not None
        if not already:
            report = self.watcher.training(what, network.config.updates)
            train(release, network.config, folder, network.name, device=self.device, report=report)
        return self.finished(entry.number, what, already, started)

    def release(self, entry: RoundPlan) -> Release:
        return load(self.releases / entry.release)

    def finished(self, number: int, what: str, already: bool, started: float) -> Stage:
        """Note what the run that finished a stage spent on it."""
        stage = Stage(number, what, already, time.perf_counter() - started)
        if not already:
            note(self.networks / STAGES, what, {"round": number, "seconds": round(stage.seconds, 1)})
        return stage
