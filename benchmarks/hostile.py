"""Every hostile policy of the tests, each in a process of its own: what it tried, and how it ended.

    python benchmarks/hostile.py              # all
    python benchmarks/hostile.py SetsClock    # some

A policy is contained if it gained nothing, and counted if each of its questions has an answer or a fault, or if asking
again shows that its answers are not its own. The tries are harmless where they go through.
"""

from __future__ import annotations

import logging
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.markup import escape
from rich.table import Table

from benchmarks.results import ROOT, finish, parser, target
from evaluator.policy import PolicyHost, resolve
from tests.evaluator.policy.hostile import every
from tests.evaluator.policy.hostile.verdicts import verdict

WANTED = 60
_SHOWN = 90  # characters of what happened


def main() -> int:
    """Ask each of them, and print how it ended."""
    options = parser(__doc__)
    options.add_argument("names", nargs="*", metavar="POLICY", help="all by default")
    arguments = options.parse_args()
    logging.disable(logging.WARNING)
    with PolicyHost(resolve("random"), None) as host:
        isolation = host.isolation
    found = {}
    table = Table("policy", "kind", "contained", "counted", "seconds", "what happened", title="hostile policies")
    for name in arguments.names or every.POLICIES:
        began = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            one = verdict(name, Path(folder))
        found[name] = one = replace(one, found=one.found.replace(f"{ROOT}/", ""))
        kind = every.POLICIES[name].__module__.rpartition(".")[2]
        seconds = time.perf_counter() - began
        said = escape(one.found if len(one.found) <= _SHOWN else f"{one.found[:_SHOWN]}...")
        table.add_row(name, kind, _word(one.contained), _word(one.counted), f"{seconds:.1f}", said)
    contained, counted = (sum(getattr(one, name) for one in found.values()) for name in ("contained", "counted"))
    wanted = len(found)
    targets = [
        target("hostile policies contained", f"all of {wanted}", f"{contained}", contained == wanted),
        target("hostile policies counted", f"all of {wanted}", f"{counted}", counted == wanted),
    ]
    if not arguments.names:
        targets.append(target("hostile policies", f">= {WANTED}", f"{wanted}", wanted >= WANTED))
    numbers = {
        "isolation": isolation.to_dict(),
        "policies": {
            name: {"contained": one.contained, "counted": one.counted, "found": one.found}
            for name, one in found.items()
        },
    }
    return finish(arguments, "hostile", [table], targets, [f"The sandbox was {isolation}."], numbers)


def _word(yes: bool) -> str:
    return "yes" if yes else "NO"


if __name__ == "__main__":
    sys.exit(main())
