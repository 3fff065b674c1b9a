"""``collect``: a plan becomes a sealed release, through as many interruptions as it takes."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path

from baselines.rounds.plan import CollectionPlan
from baselines.rounds.play import BATCH, BehaviourPolicies, Player
from baselines.rounds.work import CHUNK_EPISODES, WorkFolder, cut, work_path
from evaluator.engines import Engine, make_engine
from evaluator.engines.child import call_in_child
from evaluator.run.environment import source_digest
from evaluator.runner import Backend, default_backend
from evaluator.scenarios.varied import VARIES
from rema_data.errors import InputError, IntegrityError, PolicyFailureError, RunMismatchError
from rema_data.interrupts import check
from rema_data.progress import Progress, Silent
from rema_data.release.folder import ReleaseFolder, find_release
from rema_data.release.manifest import MANIFEST, parse_manifest
from rema_data.release.registry import load_published, published
from rema_data.release.seal import seal
from rema_data.storage import file_sha256
from rema_data.store.block import BlockKey, BlockReader, BlockWriter, encode_episodes
from rema_data.store.columns import VARIATION, version_with
from rema_data.verify.leakage import Scenes, frozen_scenes

__all__ = ["Collected", "collect", "inherit"]


@dataclass(frozen=True, slots=True)
class Collected:
    """The sealed release of a plan, and whether it was there before."""

    release: ReleaseFolder
    already: bool


def collect(
    plan: CollectionPlan,
    output: Path,
    *,
    engine: str = "process",
    workers: int | None = None,
    address: str | None = None,
    progress: Progress | None = None,
    backend: Backend | None = None,
    chunk_episodes: int = CHUNK_EPISODES,
) -> Collected:
    """Play every episode of a plan that has not been committed yet, then seal the release ``output / name``.

    ``engine``, ``workers`` and ``address`` are those of ``make_engine``: no byte of the release depends on them.
    ``backend`` is the real world by default. ``chunk_episodes`` are committed together; a policy is asked about one
    chunk at a time, so this number is part of the identity of a collection.

    Raises RunMismatchError where another release or plan uses the name, InputError where another process collects it,
    the parent lacks a round or OpenVINO is missing, SubmissionError or PolicyFailureError where a policy fails, and
    InfrastructureError, StorageError or KeyboardInterrupt where it was stopped; run again to go on.
    """
    collection = _Collection(plan, output, progress or Silent(), backend or default_backend(), chunk_episodes)
    return collection.run(partial(make_engine, engine, workers, address=address))


def inherit(plan: CollectionPlan, output: Path) -> tuple[ReleaseFolder | None, list[BlockKey]]:
    """The parent of a plan's release, and the blocks that are taken from it.

    Raises InputError or MissingFileError where they do not lie whole beside the new release, RunMismatchError where
    other data do.
    """
    if plan.parent is None:
        return None, []
    parent = find_release(plan.parent)
    blocks = [block for block in parent.manifest.blocks if block.round in plan.reused]
    for number in plan.reused:
        if number not in {block.round for block in blocks}:
            raise InputError(
                f"{plan.path}: rounds[{number}] is to be reused, but {parent.manifest.name} has no round {number}",
                hint="fix the plan's rounds",
                round=number,
            )
    parent.require(blocks)
    beside = ReleaseFolder(parent.manifest, output)
    files = parent.manifest.files_of(blocks)
    absent = sorted({file.holder for file in files if not beside.has(file)})
    if absent:
        raise InputError(
            f"the reused rounds lie in {', '.join(absent)}, which is not in {output}, or not whole",
            hint=f"collect beside it: --output {parent.root}",
            holders=absent,
        )
    for file in files:
        if file_sha256(beside.file(file)) != file.sha256:
            raise RunMismatchError(
                f"{beside.file(file)} is not that of {parent.manifest.name}, whose rounds are reused",
                hint=f"collect beside that release: --output {parent.root}"
                if parent.root.resolve() != output.resolve()
                else beside.repair.at(beside.file(file)),
                path=str(beside.file(file)),
            )
    return parent, [block.key for block in blocks]


class _Collection:
    def __init__(
        self, plan: CollectionPlan, output: Path, progress: Progress, backend: Backend, chunk_episodes: int
    ) -> None:
        self.plan, self.output, self.progress, self.backend = plan, output, progress, backend
        self.chunks = list(cut(plan.blocks, chunk_episodes))
        self.parent, self.reused = inherit(plan, output)
        self.work = work_path(output, plan.about.name)
        self.policies = BehaviourPolicies(plan.blocks, backend, self.work)
        self.fingerprint: dict[str, str] = call_in_child(backend.fingerprint)
        self.version = self.schema_version()
        self.identity = {  # all that decides a byte of a chunk, ready for JSON
            "schema_version": self.version,
            "seed": plan.seed,
            "blocks": [
                {
                    "block": block.key.path,
                    "episodes": block.episodes,
                    "policies": [[use.spec.name, self.policies.digests[use], use.device] for use in block.policies],
                    **({} if block.vary is None else {"vary": block.vary._asdict()}),
                }
                for block in plan.blocks
            ],
            "batches": [chunk_episodes, BATCH],
            "fingerprint": self.fingerprint,
        }

    def schema_version(self) -> int:
        """Of every block that is collected: the earliest version that has what the plan and its parent use."""
        continued = self.parent.manifest.schema_version if self.parent is not None and self.reused else 1
        return max(continued, version_with(*([VARIATION] if self.varies else [])))

    @property
    def varies(self) -> bool:
        """Whether any block has varied episodes."""
        return any(block.vary is not None for block in self.plan.blocks)

    @property
    def code(self) -> str:
        """Identity of the code that decides a byte of an episode: episodes of other code are not mixed with these."""
        drawing = [source_digest(*VARIES)] if self.varies else []  # clean episodes are drawn by the world alone
        return " ".join([self.backend.observation_hash, *drawing])

    @cached_property
    def plan_sha256(self) -> str:
        """Identity of the plan: its meaning, its policies and the simulator, but not the code of the world."""
        parent = None if self.parent is None else self.parent.manifest.sha256
        reused = {"parent": parent, "reused": list(self.plan.reused)}
        content = {"about": asdict(self.plan.about), **self.identity, **reused}
        return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()

    def sealed(self) -> Collected | None:
        """The release, where this plan has made it before."""
        target = self.output / self.plan.about.name
        if not target.exists():
            return None
        path = target / MANIFEST
        manifest = parse_manifest(path.read_bytes(), str(path)) if path.is_file() else None
        if manifest is None or manifest.plan_sha256 != self.plan_sha256:
            what = "is not a sealed release" if manifest is None else "was made by another plan, policy or simulator"
            raise RunMismatchError(
                f"{target} {what}: a sealed release is never written to",
                hint="give the plan another name, or choose another folder with --output",
                path=str(target),
            )
        return Collected(ReleaseFolder(manifest, self.output), already=True)

    def check_name(self) -> None:
        """Raise where the name is that of a published release which this plan has not made."""
        name = self.plan.about.name
        if name in published() and load_published(name).plan_sha256 != self.plan_sha256:
            raise RunMismatchError(
                f"{self.plan.path}: {name} is a published release, made by another plan, policy or simulator",
                hint="give the plan another name",
                path=str(self.plan.path),
                name=name,
            )

    def run(self, start_engine: Callable[[str], Engine]) -> Collected:
        found = self.sealed()
        if found is None:
            self.check_name()
            self.plan.check_devices()
            frozen = frozen_scenes()  # read before anything is played: without them nothing can be sealed
            with WorkFolder.locked(self.work, {**self.identity, "code": self.code}) as work:
                found = self.sealed()  # another process may have sealed it meanwhile
                if found is None:
                    self.play(work, start_engine)
                    found = Collected(self.seal(work, frozen), already=False)
        shutil.rmtree(self.work, ignore_errors=True)
        return found

    def play(self, work: WorkFolder, start_engine: Callable[[str], Engine]) -> None:
        """Play and commit what is missing."""
        missing = [chunk for chunk in self.chunks if not work.has(chunk)]
        if not missing:
            return
        total = sum(block.episodes for block in self.plan.blocks)
        left = sum(chunk.stop - chunk.start for chunk in missing)
        if left < total:
            self.progress.note(f"resumed: {total - left:,} of {total:,} episodes are there")
        self.progress.phase("collect", left)
        vary = {block.key: block.vary for block in self.plan.blocks}
        player = Player(self.plan.seed, self.backend, self.policies.of, vary)
        try:
            with closing(self.policies), closing(start_engine(self.backend.simulator)) as running:
                self.policies.start(chunk.block for chunk in missing)
                for chunk, episodes in player.play(missing, running, self.progress.advance):
                    work.commit(chunk, encode_episodes(episodes, self.version))
        except PolicyFailureError as error:
            error.hint = f"fix the policy, delete {self.work} and run the same command again"
            if any(self.work.glob("policy-*.log")):
                error.hint = f"what it printed is in {self.work}/policy-*.log\n{error.hint}"
            raise

    def seal(self, work: WorkFolder, frozen: Mapping[bytes, str]) -> ReleaseFolder:
        """Merge the chunks and seal the release."""
        staging = work.staging()
        self.progress.phase("seal", len(self.chunks))
        for block in self.plan.blocks:
            writer = BlockWriter(staging / block.key.path)
            for chunk in (chunk for chunk in self.chunks if chunk.block == block.key):
                writer.append(*work.read(chunk))
                self.progress.advance(1)
                check()
            writer.close()
        self.refuse_leaks(staging, frozen)
        return seal(
            staging,
            self.output,
            self.plan.about,
            [block.key for block in self.plan.blocks],
            fingerprint=self.fingerprint,
            plan_sha256=self.plan_sha256,
            parent=None if self.parent is None else self.parent.manifest,
            reused=self.reused,
        )

    def refuse_leaks(self, staging: Path, frozen: Mapping[bytes, str]) -> None:
        """Raise IntegrityError where a scene for training is one for validation too, or a frozen one."""
        scenes = Scenes()
        for block in self.plan.blocks:
            scenes.add(block.key.path, block.key.split, BlockReader(staging / block.key.path).steps())
        scenes.check(frozen, self._leaks)

    def _leaks(self, block: str, where: str, detail: str) -> None:
        raise IntegrityError(
            f"{where} of {block} in {self.plan.about.name} may not be sealed: {detail}",
            hint=f"draw other scenes: give the plan another seed, and delete {self.work}",
            block=block,
        )
