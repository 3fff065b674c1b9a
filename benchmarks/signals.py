"""Stops every long verb by a signal at random moments, runs it again, and compares its bytes and what is left behind.

    python benchmarks/signals.py                                    # 20 signals to each of nine verbs
    python benchmarks/signals.py --signals 3 --verbs export merge
    python benchmarks/signals.py --signals 1 --small

In turn: Ctrl-C (SIGINT to the process group), SIGTERM, SIGHUP, and SIGTERM with a second signal after half a second.
The moment is drawn from the time that an undisturbed run took; a signal is sent once the process handles it, since the
start of Python itself is not ours. A verb that ended before its signal arrived counts as another draw. Each run has a
home, a folder for temporary files and an output of its own. Exits with 6 if anything is not as it should be.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.table import Table

from benchmarks.results import ROOT, finish, parser, target
from tests.rema_data.download.servers import serve

LIMIT_S = 5.0
RATE = 2e6
"""Bytes a second of the server, so that moments fall into the transfer."""
DRAWS = 3
"""So often a moment is drawn for one signal, where the verb was quicker than the signal."""
PLAN = """
name = "stopped"
title = "Stopped"
description = "To be interrupted."
license = "CC-BY-4.0"
citation = "Nobody."
seed = 7
[[rounds]]
policy = "random"
episodes = {{ train = {episodes}, val = 20 }}
tasks = ["push"]
"""
NETWORK = """
[[rounds.networks]]
network = "joint/push"
primitive = "push"
tasks = ["push"]
updates = {updates}
validate_every = {every}
validation_steps = 20
architecture = {{ width = 8 }}
"""
KINDS: tuple[tuple[str, signal.Signals, bool], ...] = (
    ("Ctrl-C", signal.SIGINT, False),
    ("SIGTERM", signal.SIGTERM, False),
    ("SIGHUP", signal.SIGHUP, False),
    ("SIGTERM twice", signal.SIGTERM, True),
)


@dataclass(frozen=True)
class Verb:
    """A command in a folder of its own, and the files that must not differ."""

    words: tuple[str, ...]
    results: tuple[str, ...]  # patterns below the folder


@dataclass(frozen=True)
class Size:
    """How much there is to do."""

    release: str
    task: str
    episodes: int
    updates: int


FULL = Size("rema-mini", "push", 1500, 300)
SMALL = Size("rema-sample", "push", 30, 6)


def command(*words: str) -> list[str]:
    """A verb of this checkout."""
    return [sys.executable, "-m", "evaluator.cli", *words]


def environment(folder: Path) -> dict[str, str]:
    """With home and temporary files in a folder."""
    (folder / "tmp").mkdir(parents=True, exist_ok=True)
    own = {"REMA_HOME": str(folder / "home"), "TMPDIR": str(folder / "tmp"), "PYTHONPATH": str(ROOT)}
    return {**os.environ, **own, "OMP_NUM_THREADS": "1"}


def prepare(inputs: Path, size: Size, names: Sequence[str], url: str) -> dict[str, Verb]:
    """Make what the verbs need, and the verbs."""
    every = max(2, size.updates // 6)
    (inputs / "collect.toml").write_text(PLAN.format(episodes=size.episodes))
    network = NETWORK.format(updates=size.updates, every=every)
    (inputs / "rounds.toml").write_text(PLAN.format(episodes=max(40, size.episodes // 5)) + network)
    evaluate = ("evaluate", "random", "--task", size.task, "--episodes", str(size.episodes), "--workers", "2")
    evaluate += ("--batch-size", "8")
    if "import" in names:
        make(inputs, "export", size.release, "--task", size.task, "--output", str(inputs / "exported"))
    if "merge" in names:
        for shard in ("1/2", "2/2"):
            make(inputs, *evaluate, "--shard", shard, "--output", str(inputs / f"shard-{shard[0]}"))
    training = ("--release", size.release, "--tasks", size.task, "--primitive", "push", "--updates", str(size.updates))
    training += ("--validate-every", str(every), "--validation-steps", "20", "--width", "8", "--output", "out")
    two = ("--updates", "2", "--validate-every", "2")  # the first open of a release, and little after it
    run = ("out/results.parquet", "out/actions.bin")
    sealed, networks = "out/stopped/**/*", "out/**/*.safetensors"
    verbs = {
        "export": Verb(("export", size.release, "--task", size.task, "--output", "out"), ("out/*.hdf5",)),
        "import": Verb(("import", str(inputs / "exported"), "--output", "out", "--name", "back"), ("out/back/**/*",)),
        "collect": Verb(("collect", str(inputs / "collect.toml"), "--output", "out", "--workers", "2"), (sealed,)),
        "train": Verb(("train", *training), (networks,)),
        "rounds": Verb(("rounds", str(inputs / "rounds.toml"), "--output", "out"), (sealed, networks)),
        "merge": Verb(("merge", str(inputs / "shard-1"), str(inputs / "shard-2"), "--output", "out"), run),
        "download": Verb(
            ("download", size.release, "--source", url, "--jobs", "2"), (f"home/releases/{size.release}/**/*",)
        ),
        "decode": Verb(("train", *training, *two), ("home/decoded/*/*.npy", networks)),
        "evaluate": Verb((*evaluate, "--output", "out"), run),
    }
    return {name: verbs[name] for name in names}


def make(inputs: Path, *words: str) -> None:
    """Run a verb that makes an input."""
    done = subprocess.run(command(*words), cwd=inputs, env=environment(inputs), capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(words)} ended with {done.returncode}:\n{done.stderr}")


def digests(verb: Verb, folder: Path) -> dict[str, str]:
    """Of the files that must not differ."""
    paths = sorted(path for pattern in verb.results for path in folder.glob(pattern) if path.is_file())
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def names(folder: Path) -> set[str]:
    """Everything in a folder, but the journals of a run: every process begins its own."""
    found = (path.relative_to(folder).as_posix() for path in folder.rglob("*"))
    return {name for name in found if "/records/" not in name and not name.startswith("error-")}


def listens(pid: int) -> bool:
    """Whether a process handles SIGTERM; where the system does not say, it does."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return True
    caught = int(status.split("SigCgt:")[1].split()[0], 16)
    return bool(caught >> (signal.SIGTERM - 1) & 1)


def started(verb: Verb, folder: Path, errors: Any) -> subprocess.Popen[bytes]:
    """The verb, in a process group of its own."""
    return subprocess.Popen(
        command(*verb.words),
        cwd=folder,
        env=environment(folder),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=errors,
        start_new_session=True,
    )


def whole_run(verb: Verb, folder: Path) -> tuple[float, str]:
    """Seconds of a run to its end, from the moment at which it listens; and what it wrote on stderr if it failed."""
    folder.mkdir(exist_ok=True)
    with tempfile.TemporaryFile() as errors, started(verb, folder, errors) as process:
        while process.poll() is None and not listens(process.pid):
            time.sleep(0.002)
        start = time.monotonic()
        process.wait()
        seconds = time.monotonic() - start
        errors.seek(0)
        return seconds, errors.read().decode() if process.returncode else ""


def stop(verb: Verb, folder: Path, kind: tuple[str, signal.Signals, bool], after_s: float) -> dict[str, Any] | None:
    """What a signal did; None where the verb had ended before."""
    name, number, twice = kind
    folder.mkdir()
    with tempfile.TemporaryFile() as errors, started(verb, folder, errors) as process:
        while process.poll() is None and not listens(process.pid):
            time.sleep(0.002)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(after_s)
        if process.poll() is not None:
            return None
        start = time.monotonic()
        send(process, number)
        if twice:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.5)
            send(process, signal.SIGINT)
        process.wait()
        took_s = time.monotonic() - start
        errors.seek(0)
        said = errors.read().decode(errors="replace")
    if process.returncode == 0:
        return None
    bad = [word for word in ("Traceback", "Segmentation", "Fatal", "Error") if word in said]
    clean = process.returncode == 128 + number and took_s <= LIMIT_S and not bad
    return {"signal": name, "after_s": round(after_s, 2), "code": process.returncode, "took_s": round(took_s, 2),
            "clean": clean, "said": "" if clean else said[-2000:]}  # fmt: skip


def send(process: subprocess.Popen[bytes], number: int) -> None:
    """Ctrl-C reaches the whole group, other signals the process."""
    with contextlib.suppress(ProcessLookupError):
        if number == signal.SIGINT:
            os.killpg(process.pid, number)
        else:
            os.kill(process.pid, number)


def measure(name: str, verb: Verb, folder: Path, count: int, rng: random.Random) -> Iterator[dict[str, Any]]:
    """One row a signal."""
    reference = folder / "reference"
    seconds, failed = whole_run(verb, reference)
    if failed:
        raise SystemExit(f"the undisturbed {name} failed:\n{failed}")
    wanted, usual = digests(verb, reference), names(reference)
    if not wanted:
        raise SystemExit(f"{name} made no file to compare")
    for number in range(count):
        for draw in range(DRAWS):
            place = folder / f"{number}-{draw}"
            row = stop(verb, place, KINDS[number % len(KINDS)], rng.uniform(0, seconds))
            if row is not None:
                break
        else:
            continue
        _, failed = whole_run(verb, place)
        same = not failed and digests(verb, place) == wanted
        left = sorted(names(place) - usual)
        yield {"verb": name, **row, "same": same, "left": left, "again": failed[-2000:]}


def main() -> int:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--signals", type=int, default=20, help="to each verb")
    options.add_argument("--verbs", nargs="+", default=None)
    options.add_argument("--small", action="store_true", help="little to do: for tests")
    options.add_argument("--seed", type=int, default=1)
    arguments = options.parse_args()
    size = SMALL if arguments.small else FULL
    all_verbs = ("export", "import", "collect", "train", "rounds", "merge", "download", "decode", "evaluate")
    chosen = arguments.verbs or all_verbs
    table = Table("verb", "signals", "clean ends", "slowest end, s", "same bytes", "left behind", title="signals")
    rows: list[dict[str, Any]] = []
    with (
        tempfile.TemporaryDirectory(prefix="rema-signals-") as name,
        serve(ROOT / "releases", bytes_per_second=RATE) as server,
    ):
        (inputs := Path(name) / "inputs").mkdir()
        for verb, made in prepare(inputs, size, chosen, server.url).items():
            (folder := Path(name) / verb).mkdir()
            of_verb = []
            for row in measure(verb, made, folder, arguments.signals, random.Random(f"{arguments.seed} {verb}")):
                of_verb.append(row)
                if not (row["clean"] and row["same"]) or row["left"]:
                    print(row, file=sys.stderr, flush=True)
            rows += of_verb
            counted = [str(sum(row[key] for row in of_verb)) for key in ("clean", "same")]
            slowest = max((row["took_s"] for row in of_verb), default=0.0)
            left = str(sum(bool(row["left"]) for row in of_verb))
            table.add_row(verb, str(len(of_verb)), counted[0], f"{slowest:.1f}", counted[1], left)
            print(f"{verb}: {len(of_verb)} signals, {counted[0]} clean", file=sys.stderr, flush=True)
    total = len(rows)
    clean, same = (sum(row[key] for row in rows) for key in ("clean", "same"))
    left = sum(bool(row["left"]) for row in rows)
    targets = [
        target(f"ends with its code within {LIMIT_S:g} s, no traceback", str(total), str(clean), clean == total),
        target("same bytes after running again", str(total), str(same), same == total),
        target("runs that leave something behind", "0", str(left), left == 0),
    ]
    wrong = clean < total or same < total or left > 0
    return finish(arguments, "signals", [table], targets, [], {"signals": rows}, mismatch=wrong)


if __name__ == "__main__":
    sys.exit(main())
