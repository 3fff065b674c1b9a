"""No input makes a parser fail with a traceback, hang, take the machine's memory, or read something else silently."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import defaultdict

import pytest

from tests.mutations.mutators import FORGERIES, damaged
from tests.mutations.parsers import PARSERS
from tests.mutations.trial import GOOD, ROOT, Trial, trials

COUNT = 12
"""Inputs of each parser here; ``benchmarks/mutations.py`` takes 600."""


@pytest.fixture(scope="module")
def found() -> dict[str, list[Trial]]:
    """The trials of every parser, from one process."""
    by_parser: defaultdict[str, list[Trial]] = defaultdict(list)
    for trial in trials([parser.name for parser in PARSERS], COUNT):
        by_parser[trial.parser].append(trial)
    return by_parser


@pytest.mark.parametrize("name", [parser.name for parser in PARSERS])
def test_mutated_inputs_are_refused_or_read_as_they_were(name: str, found: dict[str, list[Trial]]) -> None:
    wrong = [trial for trial in found[name] if trial.result not in GOOD]
    assert not wrong, "\n".join(f"{one.number}, {one.kind}: {one.result} {one.detail}" for one in wrong)
    assert len(found[name]) >= 3


@pytest.mark.slow
@pytest.mark.parametrize("name", [parser.name for parser in PARSERS])
def test_six_hundred_mutated_inputs(name: str) -> None:
    wrong = [trial for trial in trials([name], 600) if trial.result not in GOOD]
    assert not wrong, "\n".join(f"{one.number}, {one.kind}: {one.result} {one.detail}" for one in wrong)


def test_a_file_on_which_the_hdf5_library_loops_is_refused() -> None:
    """Reading an attribute of this one never ends, and nothing in the process could interrupt it."""
    one = [sys.executable, "-m", "tests.mutations.trial", '[["import of HDF5", 149]]', "150", "0"]
    done = subprocess.run(one, capture_output=True, text=True, cwd=ROOT, timeout=100)
    found = Trial(**json.loads(done.stdout.splitlines()[-1]))
    assert found.result == "refused" and "does not come to an end" in found.detail


def test_there_are_more_than_eighteen_parsers() -> None:
    names = [parser.name for parser in PARSERS]
    assert len(set(names)) == len(names) > 18
    assert {how for parser in PARSERS for how in parser.forge.values()} == set(FORGERIES)


def test_a_mutation_follows_from_its_seed_and_changes_something() -> None:
    import numpy as np

    data = b'{"a": [1, 2, 3], "b": {"c": "d"}}' * 20
    once, again = ([damaged(data, np.random.default_rng([0, n])) for n in range(50)] for _ in range(2))
    assert once == again and data not in once and len(set(once)) > 45
