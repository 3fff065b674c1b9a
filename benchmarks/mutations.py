"""Gives every parser mutated inputs: files that were damaged, and files whose content somebody forged.

    python benchmarks/mutations.py                       # 600 inputs for each parser
    python benchmarks/mutations.py --count 50 --parsers "entry,checkpoint"

An input is right to be refused (by an error of rema that names the file), or to read as the undamaged one. Forged
content, and files that people edit, may be read as what they say. Wrong are other content without a word (silent), any
other exception (traceback), more than 1 GiB of memory, more than 20 s (hang), and a process that died (crash). Exits
with 6 where something is wrong.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.table import Table

from benchmarks.results import finish, parser, target
from tests.mutations.parsers import PARSERS
from tests.mutations.trial import GOOD, WRONG, trials

RESULTS = (*GOOD, *WRONG)


def main() -> int:
    made = parser(__doc__)
    made.add_argument("--count", type=int, default=600, help="inputs for each parser")
    made.add_argument("--seed", type=int, default=0)
    made.add_argument("--parsers", help="names, separated by commas; all by default")
    arguments = made.parse_args()
    names = arguments.parsers.split(",") if arguments.parsers else [one.name for one in PARSERS]
    table = Table("parser", "inputs", *RESULTS, "slowest, s", title="Mutated inputs")
    rows: dict[str, dict[str, Any]] = {}
    for name in names:
        found = list(trials([name], arguments.count, arguments.seed))
        counts = Counter(trial.result for trial in found)
        slowest = max(trial.seconds for trial in found)
        rows[name] = {"inputs": len(found), **{result: counts[result] for result in RESULTS}, "slowest_s": slowest}
        table.add_row(name, *(str(value) for value in rows[name].values()))
        for trial in found:
            if trial.result in WRONG:
                print(
                    f"{name} {trial.number}, {trial.kind}: {trial.result} {trial.detail}", file=sys.stderr, flush=True
                )
    wrong = sum(row[result] for row in rows.values() for result in WRONG)
    total = sum(row["inputs"] for row in rows.values())
    targets = [target(f"{total:,} mutated inputs of {len(rows)} parsers", "none wrong", f"{wrong:,} wrong", not wrong)]
    return finish(arguments, "mutations", [table], targets, [], {"parsers": rows}, mismatch=bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
