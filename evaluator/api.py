"""What ``from evaluator import ...`` offers, with plain arguments; the verbs of ``rema`` call the same functions."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rema_data.errors import InputError

if TYPE_CHECKING:
    from evaluator.leaderboard import Board
    from evaluator.leaderboard.comparison import Comparison
    from evaluator.replay import ReplayReport
    from evaluator.run.run import Run
    from evaluator.runner import EvaluationResult
    from rema_data.progress import Progress

__all__ = ["compare", "evaluate", "leaderboard", "read_run", "replay"]


def evaluate(
    policy: str | Path,
    *,
    task: str,
    episodes: int | None = None,
    output: str | Path | None = None,
    checkpoint: str | Path | None = None,
    device: str = "cpu",
    protocol: str = "conditional",
    split: str = "test",
    suite: str | None = None,
    fresh: int | None = None,
    engine: str = "process",
    workers: int | None = None,
    address: str | None = None,
    shard: str | None = None,
    batch_size: int = 64,
    sandbox: str | None = None,
    quick: str | Path | None = None,
    progress: Progress | None = None,
) -> EvaluationResult:
    """Score a policy on frozen scenarios, or resume a run that was stopped.

    Parameters
    ----------
    policy : str or Path
        ``my_policy.py``, ``my_policy.py:ClassName`` or the name of an installed policy.
    task : str
    episodes : int, optional
        The first so many scenarios of the list; by default all: 10,000 of ``test``, 2,000 of ``val``.
    output : str or Path, optional
        Run folder; ``runs/POLICY-TASK-PROTOCOL`` by default.
    checkpoint : str or Path, optional
        Weights, handed to the policy; an installed policy may bring its own.
    device : str
        Handed to the policy.
    protocol : {"conditional", "end-to-end", "blank-scene", "blank-hand"}
    split : {"test", "val"}
    suite : str, optional
        A generalisation suite, such as ``hard-v1``: its scenarios in place of the clean ones.
    fresh : int, optional
        A seed: a list is drawn from it, of as many scenarios as ``episodes``, by default 2,000.
    engine : str
        Where the simulation runs: ``process``, ``inline``, ``ray`` or another installed engine.
    workers : int, optional
        Simulation processes; one a core by default.
    address : str, optional
        Of a Ray cluster.
    shard : str, optional
        ``"I/N"``: play this shard of the scenarios only; ``rema merge`` merges the shards.
    batch_size : int
        Observations in one question to the policy.
    sandbox : str, optional
        Wrapper of the policy's process, such as bwrap: see docs/threat_model.md.
    quick : str or Path, optional
        A run folder or an entry: stop as soon as the policy is better or worse than that run. Such a run has no rank.
    progress : Progress, optional

    Returns
    -------
    EvaluationResult
        ``folder`` and ``summary``, the content of its ``summary.json``.

    Raises
    ------
    RemaError
        SubmissionError where the policy does not load, PolicyFailureError where
        it fails on more than 10 % of the episodes, InputError for an argument that cannot be used.

    Examples
    --------
    >>> from evaluator import evaluate
    >>> result = evaluate("random", task="grasp", episodes=4, workers=1)
    >>> result.summary["episodes"], str(result.folder)
    (4, 'runs/random-grasp-conditional')
    """
    from evaluator.policy.loading import resolve, weights_of
    from evaluator.runner import EvaluationConfig, run_evaluation
    from evaluator.runner.shards import RunShard

    spec = resolve(str(policy))
    run_shard = None if shard is None else RunShard.parse(shard)
    config = EvaluationConfig(  # refuses what cannot be used before a list is drawn
        policy=spec,
        task=task,
        output=Path(),
        checkpoint=weights_of(spec, None if checkpoint is None else Path(checkpoint), task),
        device=device,
        protocol=protocol,
        split=split,
        episodes=1 if episodes is None else episodes,
        engine=engine,
        workers=workers,
        batch_size=batch_size,
        sandbox=sandbox,
        address=address,
    )
    version, count = _scenarios(task, split, protocol, suite, fresh, episodes, workers, progress)
    name = f"{spec.name}-{task}-{suite or protocol}" + ("" if split == "test" else f"-{split}")
    if fresh is not None:
        name += f"-{version}"
    if run_shard is not None:
        name += f"-shard-{run_shard.number}-of-{run_shard.count}"
    place = Path("runs") / name if output is None else Path(output)
    config = dataclasses.replace(config, output=place, version=version, episodes=count, shard=run_shard)
    if quick is None:
        return run_evaluation(config, progress)
    if run_shard is not None:
        raise InputError("--quick plays the list in its order", hint="drop --quick or --shard")
    from evaluator.runner.quick import quick_evaluation

    return quick_evaluation(config, Path(quick), progress, read=lambda path: read_run(path, progress=progress))


def _scenarios(
    task: str,
    split: str,
    protocol: str,
    suite: str | None,
    fresh: int | None,
    episodes: int | None,
    workers: int | None,
    progress: Progress | None,
) -> tuple[str | None, int]:
    """The version of the lists that an evaluation plays (None: the one in force), and how many of its scenarios."""
    if suite is not None and fresh is not None:
        raise InputError("a suite is frozen, a fresh list is not", hint="give --suite or --fresh")
    if suite is not None:
        from evaluator.scenarios.suites import suite_length

        if protocol != "conditional":
            raise InputError(
                f"the suite {suite} changes the last step of an episode: it has no {protocol} protocol",
                hint="drop --protocol",
                field="protocol",
            )
        length = suite_length(suite, task, split)
        return suite, length if episodes is None else episodes
    if fresh is not None:
        from evaluator.protocol import FRESH_SCENARIOS
        from evaluator.sim.bullet import require_bullet

        if split != "test":
            raise InputError(f"a fresh list has no {split} split", hint="drop --split")
        require_bullet()
        from evaluator.runner.fresh import fresh_list

        count = FRESH_SCENARIOS if episodes is None else episodes
        return fresh_list(fresh, task, count, workers, progress), count
    from evaluator.scenarios.lists import installed_list

    if episodes is not None:
        return None, episodes
    found = installed_list(task, split)
    return None, found[1] if found else 1  # without a list the run says what is missing


def read_run(path: str | Path, *, progress: Progress | None = None) -> Run:
    """A finished run, from its folder or from its entry.

    The results of an entry are derived from its actions: they are simulated (minutes) unless that was done before, here
    or by the CI of rema.

    Parameters
    ----------
    path : str or Path
        A run folder of ``evaluate``, or an entry of ``rema submit``.
    progress : Progress, optional

    Raises
    ------
    MissingFileError, InputError, IntegrityError
        It is not finished, not a run, or damaged.

    Examples
    --------
    >>> from evaluator import evaluate, read_run
    >>> run = read_run(evaluate("random", task="grasp", episodes=4, workers=1).folder)
    >>> run.policy, run.tag, run.counts.episodes
    ('random', 'random', 4)
    """
    from evaluator.leaderboard.verification import read_verified

    return read_verified(Path(path), progress)


def compare(a: str | Path, b: str | Path, *, progress: Progress | None = None) -> Comparison:
    """Compare two runs scenario by scenario.

    Parameters
    ----------
    a, b : str or Path
        Run folders or entries, of the same task, split, protocol and scenario list.
    progress : Progress, optional

    Returns
    -------
    Comparison
        The 2x2 table, the difference with its 95 % interval, and where the two differ.

    Raises
    ------
    InputError, MissingFileError, IntegrityError
        The two do not compare; or as ``read_run``.

    Examples
    --------
    >>> from evaluator import compare, evaluate
    >>> run = evaluate("random", task="grasp", episodes=4, workers=1).folder
    >>> compare(run, run).table.n
    4
    """
    from evaluator.leaderboard.comparison import compare as compare_runs

    return compare_runs(read_run(a, progress=progress), read_run(b, progress=progress))


def leaderboard(
    runs: Sequence[str | Path] | None = None,
    *,
    entries: bool = True,
    published: bool = True,
    verify: bool = False,
    progress: Progress | None = None,
) -> Board:
    """Runs, entries and published rates in one table. What is not verified stands apart, without a rank.

    Parameters
    ----------
    runs : sequence of str or Path, optional
        Run folders and entries; by default every run folder below ``runs/``.
    entries : bool
        Add the entries that come with rema.
    published : bool
        Add the paper's rates.
    verify : bool
        Simulate the actions of everything that is not verified: minutes for each run over a full list.
    progress : Progress, optional

    Returns
    -------
    Board
        ``rows``, ``remarks``, and why a source was left out (``refused``).

    Raises
    ------
    MissingFileError, InputError, IntegrityError
        No source can be read at all.

    Examples
    --------
    >>> from evaluator import evaluate, leaderboard
    >>> run = evaluate("random", task="grasp", episodes=4, workers=1).folder
    >>> [row.policy for row in leaderboard([run], entries=False, published=False).rows]
    ['random']
    """
    from evaluator.leaderboard.board import find_runs
    from evaluator.leaderboard.board import leaderboard as make_board
    from evaluator.run.entry import find_entries

    sources = find_runs(Path("runs")) if runs is None else [Path(run) for run in runs]
    every = [*sources, *(find_entries() if entries else ())]
    return make_board(every, published, simulate=verify, progress=progress)


def replay(
    run: str | Path,
    *,
    fraction: float = 1.0,
    seed: int | None = None,
    engine: str = "process",
    workers: int | None = None,
    address: str | None = None,
    progress: Progress | None = None,
) -> ReplayReport:
    """Check a finished run: its seal, its statistics, and a share of its episodes by simulating them again.

    Parameters
    ----------
    run : str or Path
        Run folder; nothing in it is changed.
    fraction : float
        Share of the episodes that is simulated again, drawn at random.
    seed : int, optional
        Draw the episodes of an earlier replay.
    engine, workers, address
        As for ``evaluate``.
    progress : Progress, optional

    Returns
    -------
    ReplayReport
        ``ok``, and the findings.

    Raises
    ------
    MissingFileError, InputError, IntegrityError
        It is not a finished run, or an argument cannot be used.
    RunMismatchError, InfrastructureError
        The run was played on another scenario list than the one here; or workers cannot be started.

    Examples
    --------
    >>> from evaluator import evaluate, replay
    >>> run = evaluate("random", task="grasp", episodes=4, workers=1).folder
    >>> replay(run, workers=1).ok
    True
    """
    from evaluator.replay.play import replay as play

    return play(
        Path(run),
        fraction=fraction,
        seed=seed,
        engine=engine,
        workers=workers,
        address=address,
        progress=progress,
    )
