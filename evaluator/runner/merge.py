"""Merge several runs over parts of the scenarios to the one run that they are parts of.

A part is a run folder like any other, whose other episodes have no result. Merging takes its records, not its tables:
the tables of the whole are made from all records as those of a single run are, and so are the same bytes.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evaluator.rollout.simulate import check_infrastructure
from evaluator.run.counts import unfinished
from evaluator.run.folder import RunFolder
from evaluator.run.header import read_header, resume_command
from evaluator.run.lock import locked
from evaluator.run.plan import Plan
from evaluator.run.records import ANSWERS, OUTCOMES, Journal, Ledger, Records, read_journal
from evaluator.runner.audit import audit_summary, repeats
from evaluator.runner.config import EvaluationResult
from evaluator.runner.finalize import seal_run, write_tables
from evaluator.scenarios import ScenarioList, load_list
from rema_data.errors import InfrastructureError, InputError, RunMismatchError
from rema_data.storage import storage_errors

__all__ = ["merge_runs"]


@dataclass(frozen=True, slots=True)
class _Part:
    """A run folder and its header."""

    folder: RunFolder

    @property
    def path(self) -> Path:
        return self.folder.path

    @property
    def header(self) -> dict[str, Any]:
        return self.folder.header

    @property
    def shards(self) -> list[str]:
        """Which parts its segments say that they played, such as ``2/8``."""
        found = [str(segment["shard"]) for segment in self.header["segments"] if segment.get("shard") is not None]
        return sorted(set(found))


def merge_runs(parts: Sequence[Path], output: Path) -> EvaluationResult:
    """Merge the shards of one run.

    Parameters
    ----------
    shards : sequence of Path
        Run folders of the same policy, task, protocol, scenario list and simulator, in any order. They are not changed.
    output : Path
        Folder of the whole run, which must not exist. It can be resumed, replayed and reported like any other.

    Raises
    ------
    MissingFileError, IntegrityError
        A folder holds no run, or a damaged one; or the scenario list is not the frozen one.
    RunMismatchError
        The runs do not belong together: the message names two folders and the field that differs.
    InputError
        The output exists; another process is writing in a shard; two shards hold the same scenario, or some scenarios
        are in none.
    InfrastructureError
        More than 0.1 % of the episodes were lost, after everything is written.
    """
    if output.exists() and not (output.is_dir() and not any(output.iterdir())):
        raise InputError(f"{output} is there already", hint="choose another folder with --output", path=str(output))
    with ExitStack() as stack:
        found = [stack.enter_context(_opened(path)) for path in _distinct(parts)]
        _check_identity(found)
        first = found[0].header
        identity, episodes = first["identity"], first["episodes"]
        scenarios = _scenarios(identity)
        plan = Plan(scenarios.scenarios[:episodes], identity["task"], identity["protocol"])
        _check_disjoint(found)
        with _staged(output) as staging, RunFolder.locked(staging, identity, episodes) as folder:
            _copy_records(found, folder)
            summary, records = _finish(folder, plan, scenarios, found)
        try:
            check_infrastructure(records, summary, output)
        except InfrastructureError as error:
            if not records.contradictions:
                command = resume_command(read_header(output)[0], output)
                error.hint = f"evaluate into the merged run, which tries them again: {command}"
            raise
        return EvaluationResult(output, summary)


def _distinct(parts: Sequence[Path]) -> list[Path]:
    if not parts:
        raise InputError("there is nothing to merge", hint="give the run folders of all shards")
    seen: dict[Path, Path] = {}
    for path in parts:
        if path.resolve() in seen:
            raise InputError(f"{path} is given twice", hint="give every part once", path=str(path))
        seen[path.resolve()] = path
    return list(parts)


@contextmanager
def _opened(path: Path) -> Iterator[_Part]:
    """A part, locked against writers."""
    header, _ = read_header(path)
    with locked(path, "wait for it", only_reading=True):
        yield _Part(RunFolder(path, header))


def _check_identity(parts: Sequence[_Part]) -> None:
    """Raise where two parts are not of the same run."""
    first = parts[0]
    for other in parts[1:]:
        ours, theirs = ({**part.header["identity"], "episodes": part.header["episodes"]} for part in (first, other))
        for field in {**ours, **theirs}:
            if ours.get(field) != theirs.get(field):
                raise RunMismatchError(
                    f"{first.path} and {other.path} are not parts of one run: the {field} of the first is "
                    f"{ours.get(field)}, of the second {theirs.get(field)}",
                    hint="merge runs of the same command with other --shard",
                    field=field,
                    paths=[str(first.path), str(other.path)],
                )


def _scenarios(identity: dict[str, Any]) -> ScenarioList:
    """The list that the parts were played on.

    Raises
    ------
    RunMismatchError
        The list of this installation is another one.
    """
    found = load_list(identity["task"], identity["split"])
    if found.sha256 != identity["scenarios_hash"]:
        raise RunMismatchError(
            f"the parts were played on the scenario list {identity['scenarios_hash']}, the one here is {found.sha256}",
            hint="merge with the version of rema that evaluated",
            field="scenarios_hash",
        )
    return found


def _check_disjoint(parts: Sequence[_Part]) -> None:
    """Raise where two parts hold the same scenario."""
    owner: dict[int, _Part] = {}
    for part in parts:
        indices = {row["index"] for name in (ANSWERS, OUTCOMES) for _, row in read_journal(part.folder.records, name)}
        for index in sorted(indices):
            if index in owner:
                raise InputError(
                    f"scenario {index} is both in {owner[index].path} and in {part.path}",
                    hint="merge parts of one division, all with the same --batch-size, and every part once",
                    index=index,
                )
        owner.update(dict.fromkeys(indices, part))


@contextmanager
def _staged(output: Path) -> Iterator[Path]:
    """A folder beside ``output`` that becomes it at the end, or goes."""
    with storage_errors(output):
        output.parent.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=f".{output.name}.merging-", dir=output.parent))
        staging.chmod(0o755)
        try:
            yield staging
            staging.replace(output)
        except BaseException:
            shutil.rmtree(staging, ignore_errors=True)
            raise


def _copy_records(parts: Sequence[_Part], folder: RunFolder) -> None:
    """The journals of all parts, audits included, with their segments renumbered."""
    segments: list[dict[str, Any]] = []
    for part in parts:
        numbers = {}
        for segment in part.header["segments"]:
            numbers[segment["number"]] = len(segments) + 1
            segments.append({**segment, "number": len(segments) + 1})
        for source, target in ((part.folder.records, folder.records), (part.folder.repeats, folder.repeats)):
            for name in (ANSWERS, OUTCOMES):
                _copy_journal(source, target, name, numbers)
    folder.header["segments"] = segments
    folder.set_policy(**parts[0].header["policy"])


def _copy_journal(source: Path, target: Path, name: str, numbers: dict[int, int]) -> None:
    rows: dict[int, list[dict[str, Any]]] = {}
    for segment, row in read_journal(source, name):
        rows.setdefault(segment, []).append(row)
    for segment, some in rows.items():
        with closing(Journal(target, name, numbers[segment])) as journal:
            journal.append(some)


def _finish(
    folder: RunFolder, plan: Plan, scenarios: ScenarioList, parts: Sequence[_Part]
) -> tuple[dict[str, Any], Ledger]:
    """Tables, summary and seal of the whole run; its summary and records."""
    with closing(Ledger(folder.records, folder.segment)) as ledger:
        tables = write_tables(folder, plan, scenarios, ledger)
        if left := unfinished(plan, tables.results):
            raise _incomplete(left, len(plan.scenarios), parts)
        for part in parts:
            if "seal" not in part.header:
                raise InputError(
                    f"{part.path} has no seal: it was stopped before its audit and its tables were done",
                    hint=f"finish it: {resume_command(part.header, part.path)}",
                    path=str(part.path),
                )
        summary = seal_run(folder, plan, ledger, tables, _audit(folder, plan, ledger))
    return summary, ledger


def _incomplete(left: int, episodes: int, parts: Sequence[_Part]) -> InputError:
    """Which parts are not there, as far as the folders tell."""
    played = {shard for part in parts for shard in part.shards}
    count = max((int(shard.partition("/")[2]) for shard in played), default=0)
    missing = [shard for shard in (f"{number}/{count}" for number in range(1, count + 1)) if shard not in played]
    where = f"; no folder is of shard {', '.join(missing)}" if missing else ""
    return InputError(
        f"{left:,} of {episodes:,} episodes are in no part, or not finished{where}",
        hint="finish all shards (the same command again goes on where it stopped) and give all their folders",
        unfinished=left,
        missing=missing,
    )


def _audit(folder: RunFolder, plan: Plan, ledger: Records) -> dict[str, Any] | None:
    """What the audits of the parts found together; None where nothing was repeated."""
    with closing(Ledger(folder.repeats, folder.segment)) as again:
        done = again.answers.keys() | again.outcomes.keys()
        wanted = [repeat for repeat in repeats(plan, ledger, 1.0) if (repeat.index, repeat.step) in done]
        return audit_summary(wanted, ledger, again) if wanted else None
