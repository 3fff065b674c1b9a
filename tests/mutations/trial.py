"""Trials: mutated inputs, one after the other, in a process of their own with limited memory and time.

A worker prints one line of JSON a trial. When it hangs or dies, that is the result of the trial at hand, and another
worker goes on behind it.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np

from rema_data.errors import InputError, RemaError

__all__ = ["GOOD", "WRONG", "Trial", "given_json", "main", "trials"]

GOOD = ("refused", "same", "read")
"""Results that are as they should be: an error of ours, the content of the whole input, or content that is valid."""
WRONG = ("silent", "traceback", "memory", "hang", "crash")
"""Results that are not; silent is other content without a word."""
_FEW = 100
"""Up to so many inputs, slow parsers get fewer."""
LIMIT_BYTES = 1 << 30
LIMIT_S = 20.0
ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Trial:
    """One mutated input."""

    parser: str
    number: int
    kind: str  # damage or forgery
    result: str  # of GOOD or WRONG
    detail: str
    seconds: float


def given_json(path: Path) -> Any:
    """The content of a file that a user reads by himself; what is no JSON is not the product's to read."""
    try:
        return json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise InputError("not JSON", hint="") from error


def trials(names: Sequence[str], count: int, seed: int = 0) -> Iterator[Trial]:
    """Results of ``count`` mutated inputs for each of some parsers."""
    waiting = [(name, 0) for name in names]
    while waiting:
        last: Trial | None = None
        begun: tuple[str, int] | None = None
        command = [sys.executable, "-m", "tests.mutations.trial", json.dumps(waiting), str(count), str(seed)]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"}
        worker = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=environment)
        assert worker.stdout is not None
        hung = False
        while True:
            timer = Timer(LIMIT_S if begun else 120.0, worker.kill)
            timer.start()
            line = worker.stdout.readline()
            hung = not timer.is_alive() and not line
            timer.cancel()
            if not line:
                break
            content = json.loads(line)
            if "begins" in content:
                begun = (content["begins"][0], content["begins"][1])
                continue
            last = Trial(**content)
            begun = None
            yield last
        worker.stdout.close()
        code = worker.wait()
        if begun is None:
            if code:
                raise RuntimeError(f"a worker ended with {code} between two trials, after {last}")
            return
        name, number = begun
        yield Trial(name, number, "", "hang" if hung else "crash", f"exit code {code}", LIMIT_S)
        names = [one for one, _ in waiting]
        rest = names[names.index(name) + 1 :]
        waiting = [(name, number + 1), *((one, 0) for one in rest)]


def main() -> None:
    """Be a worker."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("waiting", type=json.loads, help="parsers, each with its first number, as JSON")
    parser.add_argument("count", type=int)
    parser.add_argument("seed", type=int)
    options = parser.parse_args()
    _work(options.waiting, options.count, options.seed)


def _work(waiting: Sequence[tuple[str, int]], count: int, seed: int) -> None:
    from tests.mutations.parsers import PARSERS

    known = {parser.name: parser for parser in PARSERS}
    with tempfile.TemporaryDirectory() as temporary:
        for name, first in waiting:
            folder = Path(temporary)
            whole, work = folder / "whole", folder / "work"
            parser = known[name]
            for old in (whole, work):
                shutil.rmtree(old, ignore_errors=True)
            whole.mkdir()
            os.environ |= {"REMA_HOME": str(whole / "home"), "REMA_MANIFESTS": str(whole / "manifests")}
            parser.make(whole)
            shutil.copytree(whole, work)
            _settle(work)
            wanted = parser.read(work)
            for number in range(first, count if count > _FEW else count // parser.slow):
                print(json.dumps({"begins": [name, number]}), flush=True)
                shutil.rmtree(work)
                shutil.copytree(whole, work)
                print(json.dumps(asdict(_try(parser, wanted, work, number, seed))), flush=True)


def _settle(folder: Path) -> None:
    """What the product calls home, and its lists, are below the folder of the trial."""
    os.environ["REMA_HOME"] = str(folder / "home")
    own = folder / "manifests"
    os.environ["REMA_MANIFESTS"] = str(own if own.is_dir() else ROOT / "manifests")


def _try(parser: Any, wanted: Any, work: Path, number: int, seed: int) -> Trial:
    from tests.mutations.mutators import FORGERIES, damaged
    from tests.mutations.parser import Again, described

    rng = np.random.default_rng([seed, number])
    forges = {path: how for glob, how in parser.forge.items() for path in sorted(work.glob(glob)) if path.is_file()}
    files = [path for glob in parser.damage for path in sorted(work.glob(glob)) if path.is_file()]
    forgery = bool(forges) and number % 2 == 1
    file = list(forges)[int(rng.integers(len(forges)))] if forgery else files[int(rng.integers(len(files)))]
    data = file.read_bytes()
    file.write_bytes(FORGERIES[forges[file]](data, rng) if forgery else damaged(data, rng))
    if forgery and parser.reseal is not None:
        parser.reseal(work, file)
    began = time.perf_counter()

    def done(result: str, detail: str = "") -> Trial:
        kind = f"{'forgery' if forgery else 'damage'} of {file.name}"
        return Trial(parser.name, number, kind, result, detail[:300], round(time.perf_counter() - began, 3))

    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    unlimited = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + LIMIT_BYTES, unlimited[1]))
    try:
        found = parser.read(work)
    except MemoryError:
        return done("memory", _frames())
    except RemaError as error:
        return done("refused", str(error))
    except Exception:
        return done("traceback", _frames())
    finally:
        resource.setrlimit(resource.RLIMIT_AS, unlimited)
    if found.agrees(wanted) if isinstance(found, Again) else described(found) == described(wanted):
        return done("same")
    return done("read" if forgery or not parser.checked else "silent")


def _frames() -> str:
    lines = traceback.format_exc().strip().splitlines()
    ours = [line.strip() for line in lines if "/rema_data/" in line or "/evaluator/" in line or "/baselines/" in line]
    return f"{lines[-1][:150]} | {' | '.join(line.split(', in ')[0].rpartition('/')[2] for line in ours[-2:])}"


if __name__ == "__main__":
    main()
