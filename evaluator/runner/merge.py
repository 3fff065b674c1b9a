"""Merge the runs of all shards of one evaluation.

A shard's run folder is like any other; the episodes of other shards have no result in it. Merging takes its records,
not its tables: the tables of the whole are made from all records, as those of a single run are, with the same bytes.

The shards come from several machines, so a sample of their actions is simulated again. It is drawn with the digest of
all that the shards hold, so that a shard cannot keep a false row out of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

from evaluator.engines.child import call_in_child
from evaluator.protocol import AUDIT_SHARE, FLIP_LIMIT
from evaluator.rollout.backend import Backend, default_backend
from evaluator.rollout.simulate import check_infrastructure, simulate_jobs
from evaluator.run.counts import unfinished
from evaluator.run.folder import RunFolder, locked
from evaluator.run.header import read_header, resume_command
from evaluator.run.plan import Plan, scenario_list
from evaluator.run.reading import read_run
from evaluator.run.records import ANSWERS, OUTCOMES, Journal, Ledger, Records, read_journal, same_outcome
from evaluator.run.seal import ACTIONS_FILE, RESULTS_FILE, canonical
from evaluator.runner.audit import Repeat, audit_summary, jobs_again, repeats, seed_of
from evaluator.runner.config import EvaluationResult
from evaluator.runner.finalize import seal_run, write_tables
from evaluator.scenarios import ScenarioList
from evaluator.sim.bullet import decisive
from evaluator.statistics import clopper_pearson
from rema_data.errors import InfrastructureError, InputError, IntegrityError, RunMismatchError
from rema_data.interrupts import check
from rema_data.leftovers import temporary_folder
from rema_data.progress import Progress, Silent
from rema_data.schema import StepOutcome
from rema_data.storage import storage_errors

__all__ = ["merge_runs"]


def merge_runs(
    shards: Sequence[Path],
    output: Path,
    progress: Progress | None = None,
    *,
    engine: str = "process",
    backend: Backend | None = None,
) -> EvaluationResult:
    """Merge all shards of one run, in any order, into the new folder ``output``; the shards are not changed.

    ``engine`` simulates the sample.

    Raises MissingFileError, IntegrityError (a folder holds no run, a damaged one or a false one, or the list is not
    frozen),
    RunMismatchError (two folders do not belong together), InputError (the output exists, a shard is in use, scenarios
    are missing or held twice), and InfrastructureError, after everything is written, where more than 0.1 % of the
    episodes were lost.
    """
    if output.exists() and not (output.is_dir() and not any(output.iterdir())):
        raise InputError(f"{output} exists already", hint="choose another folder with --output", path=str(output))
    if not shards:
        raise InputError("there is nothing to merge", hint="give the run folders of all shards")
    with ExitStack() as stack:
        found: dict[Path, RunFolder] = {}
        for path in shards:
            if path.resolve() in found:
                raise InputError(f"{path} is given twice", hint="give every shard once", path=str(path))
            header, _ = read_header(path)
            stack.enter_context(locked(path, "wait for it", only_reading=True))
            found[path.resolve()] = RunFolder(path, header)
        folders = list(found.values())
        _check_identity(folders)
        first = folders[0].header
        identity, episodes = first["identity"], first["episodes"]
        scenarios = scenario_list(first)
        plan = Plan(scenarios.scenarios[:episodes], identity["task"], identity["protocol"])
        owner = _check_disjoint(folders)
        with _staged(output) as staging, RunFolder.locked(staging, identity, episodes) as whole:
            _copy_records(folders, whole)
            world = backend or default_backend()
            summary, records = _finish(whole, plan, scenarios, folders, owner, world, engine, progress or Silent())
        try:
            check_infrastructure(records, summary, output)
        except InfrastructureError as error:
            if not records.contradictions:
                command = resume_command(read_header(output)[0], output)
                error.hint = f"evaluate into the merged run, which tries them again: {command}"
            raise
        return EvaluationResult(output, summary)


def _check_identity(shards: Sequence[RunFolder]) -> None:
    """Raise where two shards are not of the same run."""
    first = shards[0]
    for other in shards[1:]:
        ours, theirs = ({**one.header["identity"], "episodes": one.header["episodes"]} for one in (first, other))
        for field in {**ours, **theirs}:
            if ours.get(field) != theirs.get(field):
                raise RunMismatchError(
                    f"{first.path} and {other.path} are not shards of one run: the {field} of the first is "
                    f"{ours.get(field)}, of the second {theirs.get(field)}",
                    hint="merge runs of the same command with other --shard",
                    field=field,
                    paths=[str(first.path), str(other.path)],
                )


def _check_disjoint(shards: Sequence[RunFolder]) -> dict[int, Path]:
    """The folder that holds each scenario; raise where two shards hold the same one."""
    owner: dict[int, Path] = {}
    for shard in shards:
        check()
        indices = {row["index"] for name in (ANSWERS, OUTCOMES) for _, row in read_journal(shard.records, name)}
        for index in sorted(indices & owner.keys()):
            raise InputError(
                f"scenario {index} is both in {owner[index]} and in {shard.path}",
                hint="merge the shards of one division, all with the same --batch-size, and every shard once",
                index=index,
            )
        owner.update(dict.fromkeys(indices, shard.path))
    return owner


@contextmanager
def _staged(output: Path) -> Iterator[Path]:
    """A folder beside ``output`` that becomes it at the end, or is deleted."""
    with storage_errors(output), temporary_folder(f".{output.name}.merging-", output.parent) as staging:
        staging.chmod(0o755)
        yield staging
        staging.replace(output)


def _copy_records(shards: Sequence[RunFolder], whole: RunFolder) -> None:
    """Copy the journals of all shards, audits included, with their segments renumbered."""
    segments: list[dict[str, Any]] = []
    for shard in shards:
        numbers = {}
        for segment in shard.header["segments"]:
            numbers[segment["number"]] = len(segments) + 1
            segments.append({**segment, "number": len(segments) + 1})
        for source, target in ((shard.records, whole.records), (shard.repeats, whole.repeats)):
            for name in (ANSWERS, OUTCOMES):
                rows: dict[int, list[dict[str, Any]]] = {}
                for number, row in read_journal(source, name):
                    rows.setdefault(number, []).append(row)
                check()
                for number, some in rows.items():
                    with closing(Journal(target, name, numbers[number])) as journal:
                        journal.append(some)
    whole.header["segments"] = segments
    whole.set_policy(**shards[0].header["policy"])


def _finish(
    whole: RunFolder,
    plan: Plan,
    scenarios: ScenarioList,
    shards: Sequence[RunFolder],
    owner: Mapping[int, Path],
    backend: Backend,
    engine: str,
    progress: Progress,
) -> tuple[dict[str, Any], Ledger]:
    """Tables, summary and seal of the whole run; its summary and records."""
    with closing(Ledger(whole.records, whole.segment)) as ledger:
        tables = write_tables(whole, plan, scenarios, ledger)
        if left := unfinished(plan, tables.results):
            raise _incomplete(left, len(plan.scenarios), shards)
        for shard in shards:
            if "seal" not in shard.header:
                raise InputError(
                    f"{shard.path} has no seal: it was stopped before its audit and its tables were done",
                    hint=f"finish it: {resume_command(shard.header, shard.path)}",
                    path=str(shard.path),
                )
            read_run(shard.path)  # an IntegrityError where it is not what was sealed
        seals = sorted(canonical(shard.header["seal"]) for shard in shards)
        seed = seed_of(*seals, *(tables.files[name] for name in (RESULTS_FILE, ACTIONS_FILE)))
        with closing(Ledger(whole.repeats, whole.segment)) as again:
            _simulate_sample(
                whole, repeats(plan, ledger, AUDIT_SHARE, seed), ledger, again, owner, backend, engine, progress
            )
            summary = seal_run(whole, plan, ledger, tables, _audit(plan, ledger, again, seed))
    return summary, ledger


def _simulate_sample(
    whole: RunFolder,
    sample: Sequence[Repeat],
    ledger: Records,
    again: Ledger,
    owner: Mapping[int, Path],
    backend: Backend,
    engine: str,
    progress: Progress,
) -> None:
    """Simulate a sample of the actions of all shards; an IntegrityError where the outcomes are others.

    The repeats belong to the audit of the whole, unless the simulator here is not that of the shards: then only the
    labels are compared, and more than a few that differ are an error.
    """
    here, there = decisive(call_in_child(backend.fingerprint)), decisive(whole.header["identity"]["fingerprint"])
    records = Records()  # a repeat that a shard brings along proves nothing
    jobs = jobs_again(sample, ledger, Records())
    progress.phase("sample", len(jobs))
    simulate_jobs(
        jobs,
        {job.key: (sample[job.key].index, sample[job.key].step) for job in jobs},
        records,
        progress,
        simulator=backend.simulator,
        engine=engine,
        workers=1,
        order="forward",
    )
    wrong, compared = [], 0
    for key in ((sample[job.key].index, sample[job.key].step) for job in jobs):
        said, found = ledger.outcomes[key].outcome, records.outcomes[key].outcome
        if isinstance(said, StepOutcome) and isinstance(found, StepOutcome):
            compared += 1
            same = same_outcome(said, found) if here == there else said.failure == found.failure
            wrong += [] if same else [key]
    if wrong and (here == there or clopper_pearson(len(wrong), compared)[0] > FLIP_LIMIT):
        index, step = wrong[0]
        raise IntegrityError(
            f"{len(wrong):,} of {compared:,} actions that were simulated again have another outcome than recorded, the "
            f"first one in step {step} of scenario {index}, of {owner[index]}",
            hint=f"see all of it: rema replay {owner[index]}; play that shard again",
            path=str(owner[index]),
            wrong=wrong,
        )
    if here == there:
        again.add_outcomes(records.outcomes.values())
    else:
        progress.note(f"the sample was simulated by another simulator: {len(wrong)} of {compared} outcomes are others")


def _incomplete(left: int, episodes: int, shards: Sequence[RunFolder]) -> InputError:
    """The error that names the shards that are missing, as far as the folders tell."""
    played = {str(segment.get("shard")) for shard in shards for segment in shard.header["segments"]} - {"None"}
    count = max((int(shard.partition("/")[2]) for shard in played), default=0)
    missing = [shard for shard in (f"{number}/{count}" for number in range(1, count + 1)) if shard not in played]
    where = f"; no folder is of shard {', '.join(missing)}" if missing else ""
    return InputError(
        f"{left:,} of {episodes:,} episodes are in no shard, or not finished{where}",
        hint="finish all shards (the same command again continues where it stopped) and give all their folders",
        unfinished=left,
        missing=missing,
    )


def _audit(plan: Plan, ledger: Records, again: Records, seed: bytes) -> dict[str, Any] | None:
    """What the audits of the shards and the sample found; None where nothing was repeated."""
    done = again.answers.keys() | again.outcomes.keys()
    wanted = [repeat for repeat in repeats(plan, ledger, 1.0, seed) if (repeat.index, repeat.step) in done]
    return audit_summary(wanted, ledger, again) if wanted else None
