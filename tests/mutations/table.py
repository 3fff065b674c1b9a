"""The table of all trials."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence

from tests.mutations.trial import GOOD, Trial, trials

__all__ = ["print_table"]

_RESULTS = (*GOOD, "silent", "traceback", "memory", "hang", "crash")


def print_table(names: Sequence[str], count: int, seed: int) -> int:
    """Run the trials and print their results; 1 where one is not as it should be."""
    from tests.mutations.parsers import PARSERS

    chosen = list(names) or [parser.name for parser in PARSERS]
    print("| parser | inputs | " + " | ".join(_RESULTS) + " | slowest, s |")
    print("| --- |" + " ---: |" * (len(_RESULTS) + 2))
    wrong: list[Trial] = []
    for name in chosen:
        found = list(trials([name], count, seed))
        counts = Counter(trial.result for trial in found)
        numbers = " | ".join(str(counts[result]) for result in _RESULTS)
        print(f"| {name} | {len(found)} | {numbers} | {max(trial.seconds for trial in found):.2f} |", flush=True)
        wrong += [trial for trial in found if trial.result not in GOOD]
        for trial in found:
            if trial.result not in GOOD:
                text = f"{trial.parser} {trial.number}, {trial.kind}: {trial.result} {trial.detail}"
                print(text, file=sys.stderr, flush=True)
    return bool(wrong)
